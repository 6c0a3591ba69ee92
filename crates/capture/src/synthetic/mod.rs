//! The synthetic capture: path-traced images of an analytic scene with exact ground truth, for demos and tests.

mod scene;
mod shading;
mod sobol;
mod tracer;

use std::collections::BTreeMap;

use glam::DVec3;

use self::scene::AnalyticScene;
pub use self::scene::SyntheticScene;
use self::tracer::{AmbientOcclusion, Pixel, Tracer};
use crate::{Capture, CaptureError, CaptureView, GroundTruthView, SceneBounds, WorldUp, builtin};
use relume_scene::{BitDepth, Camera, EnvMap, ImageRgba, PackedImage, Plane, srgb};

/// Radius of the ball around the origin that contains the scene.
const SCENE_RADIUS: f64 = 1.2;
/// Distance of every camera from the origin.
const CAMERA_DISTANCE: f64 = 3.6;
/// Full field of view, radians; the ball just fits in it.
const FIELD_OF_VIEW: f64 = 0.691_111_2;

/// Options of [`synthetic`].
#[derive(Debug, Clone, PartialEq)]
pub struct SyntheticOptions {
    /// The scene in the images.
    pub scene: SyntheticScene,
    /// Training views, at least 3.
    pub train_views: usize,
    /// Held-out views with ground truth.
    pub test_views: usize,
    /// Places of their cameras.
    pub held_out: HeldOutCameras,
    /// Width and height of every image, pixels, 1 to 4096.
    pub size: u32,
    /// The light of the photographs.
    pub train_light: EnvMap,
    /// Lights of the relit truth, by name.
    pub relit: BTreeMap<String, EnvMap>,
    /// Light paths per pixel, 4 to 65,536; the noise is inversely proportional to the square root of their number.
    pub paths: u32,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for SyntheticOptions {
    /// 24 + 6 views of 128 x 128 pixels under `studio`, relit under `sunset`, `overcast` and `dawn`.
    fn default() -> Self {
        let light = |name: &str| builtin(name).unwrap_or_else(|| EnvMap::constant(2, 1, [1.0; 3]));
        Self {
            scene: SyntheticScene::default(),
            train_views: 24,
            test_views: 6,
            held_out: HeldOutCameras::default(),
            size: 128,
            train_light: light("studio"),
            relit: ["sunset", "overcast", "dawn"].map(|n| (n.to_owned(), light(n))).into(),
            paths: 256,
            seed: 0,
        }
    }
}

impl SyntheticOptions {
    /// The capture of `relume sample` and of `"sample": true` in `POST /v1/captures`: the scene of the demo with
    /// fewer and smaller photographs, some of them held out.
    pub fn sample() -> Self {
        Self { train_views: 20, test_views: 4, size: 96, relit: [].into(), paths: 32, ..Self::default() }
    }
}

/// Renders the synthetic capture: by default spheres, a box and a cylinder of different materials on a chequered
/// table.
///
/// World +Z is up; the scene lies within 1.2 units of the origin; camera centres are 3.6 units from it on the upper
/// hemisphere. Light has two indirect bounces. Photographs have 16 bits a channel. Equal options give equal bytes on
/// any number of threads.
///
/// # Errors
/// [`CaptureError::Field`] names the option that is out of range.
pub fn synthetic(options: &SyntheticOptions) -> Result<Capture, CaptureError> {
    check(options)?;
    let tracer = |lights, ambient_occlusion| {
        let scene = AnalyticScene::new(options.scene);
        Tracer::new(scene, lights, options.paths, options.seed, ambient_occlusion)
    };
    let train_tracer = tracer(vec![options.train_light.clone()], AmbientOcclusion::Off);
    let mut lights = vec![options.train_light.clone()];
    lights.extend(options.relit.values().cloned());
    let test_tracer = tracer(lights, AmbientOcclusion::On);
    let mut train = Vec::new();
    for i in 0..options.train_views {
        let camera = camera(spiral(i, options.train_views, 0.0), options.size)?;
        let image = image(&camera, &train_tracer.render(&camera, i as u64), 0);
        let name = format!("train_{i:03}/rgba.png");
        train.push(CaptureView {
            name,
            camera,
            image: PackedImage::new(&image, BitDepth::Sixteen),
            light_rotation_deg: 0.0,
            light_group: None,
            truth: GroundTruthView::default(),
        });
    }
    let mut test = Vec::new();
    for i in 0..options.test_views {
        let camera = held_out_camera(i, options)?;
        let pixels = test_tracer.render(&camera, (1 << 32) + i as u64);
        let (image, truth) = (image(&camera, &pixels, 0), truth(&camera, &pixels, options));
        let name = format!("test_{i:03}/rgba.png");
        let image = PackedImage::new(&image, BitDepth::Sixteen);
        test.push(CaptureView { name, camera, image, light_rotation_deg: 0.0, light_group: None, truth });
    }
    Ok(Capture {
        layout: "synthetic".to_owned(),
        train,
        test,
        points: Vec::new(),
        bounds: SceneBounds { centre: DVec3::ZERO, radius: SCENE_RADIUS },
        has_alpha: true,
        lights: options.relit.clone(),
        measured_light: None,
        grey_card: None,
        colour_chart: None,
        up: WorldUp::default(),
        turntable: None,
        warnings: Vec::new(),
    })
}

fn check(options: &SyntheticOptions) -> Result<(), CaptureError> {
    let refuse = |field: &str, reason: &str| Err(CaptureError::at_field("synthetic", field, reason));
    if options.train_views < 3 {
        return refuse("train_views", "must be at least 3");
    }
    if !(1..=4096).contains(&options.size) {
        return refuse("size", "must be 1 to 4096 pixels");
    }
    if !(4..=65_536).contains(&options.paths) {
        return refuse("paths", "must be 4 to 65536");
    }
    Ok(())
}

/// Places of the held-out cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum HeldOutCameras {
    /// Among the photographs, at the same distance.
    #[default]
    Between,
    /// Where no photograph was taken: at half and at twice the distance, at the height of the objects, and above them.
    Elsewhere,
}

/// Places of [`HeldOutCameras::Elsewhere`], one after the other: distances, as a factor of that of the photographs, and elevations in
/// degrees. Photographs have elevations of 10 to 75 degrees.
const ELSEWHERE: [(f64, f64); 4] = [(0.5, 40.0), (2.0, 40.0), (1.0, 0.0), (1.0, 88.0)];

/// The camera of held-out view `i`.
fn held_out_camera(i: usize, options: &SyntheticOptions) -> Result<Camera, CaptureError> {
    let between = spiral(i, options.test_views, 1.1);
    let centre = match options.held_out {
        HeldOutCameras::Between => between,
        HeldOutCameras::Elsewhere => {
            let (distance, elevation) = ELSEWHERE[i % ELSEWHERE.len()];
            let (sin, cos) = elevation.to_radians().sin_cos();
            (between.truncate().normalize() * cos).extend(sin) * distance
        }
    };
    camera(centre, options.size)
}

/// Point `i` of `count` on the upper hemisphere, evenly by area between 10 and 75 degrees of elevation.
fn spiral(i: usize, count: usize, turn: f64) -> DVec3 {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let (low, high) = (10f64.to_radians().sin(), 75f64.to_radians().sin());
    let z = low + (high - low) * (i as f64 + 0.5) / count as f64;
    let side = (1.0 - z * z).sqrt();
    let azimuth = turn + golden * i as f64;
    DVec3::new(side * azimuth.cos(), side * azimuth.sin(), z)
}

/// A camera at `centre`, in distances of the photographs from the origin, which it looks at.
fn camera(centre: DVec3, size: u32) -> Result<Camera, CaptureError> {
    Camera::look_at(centre * CAMERA_DISTANCE, DVec3::ZERO, DVec3::Z, FIELD_OF_VIEW, (size, size))
        .map_err(|e| CaptureError::at_field("synthetic", e.field, e.reason))
}

/// The photograph under light number `light`.
fn image(camera: &Camera, pixels: &[Pixel], light: usize) -> ImageRgba {
    let display = |p: &Pixel| {
        let [r, g, b] = p.radiance[light].as_vec3().to_array().map(srgb::encode);
        [r, g, b, p.coverage as f32]
    };
    let pixels = pixels.iter().map(display).collect();
    ImageRgba { width: camera.width, height: camera.height, pixels }
}

fn truth(camera: &Camera, pixels: &[Pixel], options: &SyntheticOptions) -> GroundTruthView {
    fn plane<const C: usize>(camera: &Camera, pixels: &[Pixel], f: impl Fn(&Pixel) -> [f32; C]) -> Plane<C> {
        Plane { width: camera.width, height: camera.height, values: pixels.iter().map(f).collect() }
    }
    let relit = options.relit.keys().enumerate();
    GroundTruthView {
        relit: relit.map(|(i, name)| (name.clone(), image(camera, pixels, i + 1))).collect(),
        albedo: Some(plane(camera, pixels, |p| p.albedo.as_vec3().to_array())),
        normal: Some(plane(camera, pixels, |p| p.normal.as_vec3().to_array())),
        metallic_roughness: Some(plane(camera, pixels, |p| p.metallic_roughness.as_vec2().to_array())),
        ambient_occlusion: Some(plane(camera, pixels, |p| [p.ambient_occlusion as f32])),
        depth: Some(plane(camera, pixels, |p| [p.depth as f32])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tiny(seed: u64, paths: u32) -> Capture {
        synthetic(&SyntheticOptions {
            train_views: 3,
            test_views: 2,
            size: 32,
            paths,
            seed,
            ..SyntheticOptions::default()
        })
        .unwrap()
    }

    /// PSNR of the covered part, dB.
    fn psnr(a: &ImageRgba, b: &ImageRgba) -> f64 {
        let pairs = a.pixels.iter().zip(&b.pixels).filter(|(p, _)| p[3] == 1.0);
        let errors: Vec<f64> =
            pairs.flat_map(|(p, q)| (0..3).map(move |k| f64::from(p[k] - q[k]).powi(2))).collect();
        -10.0 * (errors.iter().sum::<f64>() / errors.len() as f64).log10()
    }

    #[test]
    fn equal_options_give_equal_bytes_on_any_number_of_threads() {
        let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        let one = pool(1).install(|| tiny(5, 16));
        let three = pool(3).install(|| tiny(5, 16));
        assert_eq!(one, three);
        assert_ne!(one, tiny(6, 16));
    }

    #[test]
    fn cameras_elsewhere_stand_where_no_photograph_was_taken() {
        let of = |held_out| {
            let options = SyntheticOptions {
                train_views: 12,
                test_views: 4,
                held_out,
                size: 8,
                paths: 4,
                ..Default::default()
            };
            synthetic(&options).unwrap()
        };
        let nearest = |capture: &Capture, view: &CaptureView| {
            let away = |other: &CaptureView| (other.camera.centre() - view.camera.centre()).length();
            capture.train.iter().map(away).fold(f64::INFINITY, f64::min)
        };
        let (between, elsewhere) = (of(HeldOutCameras::Between), of(HeldOutCameras::Elsewhere));
        for (view, (distance, elevation)) in elsewhere.test.iter().zip(ELSEWHERE) {
            let centre = view.camera.centre();
            assert!((centre.length() / (distance * CAMERA_DISTANCE) - 1.0).abs() < 1e-9);
            assert!(((centre.z / centre.length()).asin().to_degrees() - elevation).abs() < 1e-6);
        }
        let gaps = |capture: &Capture| -> f64 { capture.test.iter().map(|v| nearest(capture, v)).sum() };
        assert!(
            gaps(&elsewhere) > 1.5 * gaps(&between),
            "the control: {} {}",
            gaps(&elsewhere),
            gaps(&between)
        );
    }

    #[test]
    fn noise_is_small_and_decreases_with_more_paths() {
        let camera = camera(spiral(3, 6, 1.1), 96).unwrap();
        let render = |seed, paths| {
            let tracer = Tracer::new(
                AnalyticScene::new(SyntheticScene::Table),
                vec![SyntheticOptions::default().train_light],
                paths,
                seed,
                AmbientOcclusion::Off,
            );
            image(&camera, &tracer.render(&camera, 0), 0)
        };
        let noise = |paths| psnr(&render(1, paths), &render(2, paths));
        let (few, many) = (noise(16), noise(256));
        assert!(many > 36.0 && many > few + 12.0, "{few} {many}");
    }

    #[test]
    fn white_light_shows_albedo_times_ambient_occlusion() {
        let white = EnvMap::constant(8, 4, [1.0; 3]);
        let capture = synthetic(&SyntheticOptions {
            train_light: white,
            test_views: 1,
            train_views: 3,
            size: 48,
            ..SyntheticOptions::default()
        })
        .unwrap();
        let view = &capture.test[0];
        let (albedo, ao) =
            (view.truth.albedo.as_ref().unwrap(), view.truth.ambient_occlusion.as_ref().unwrap());
        let material = view.truth.metallic_roughness.as_ref().unwrap();
        let mut seen = 0;
        for (i, p) in view.image.pixels().enumerate() {
            let rough_dielectric = material.values[i][0] == 0.0 && material.values[i][1] > 0.6;
            if p[3] < 1.0 || ao.values[i][0] < 0.97 || !rough_dielectric {
                continue;
            }
            seen += 1;
            for (encoded, albedo) in p[..3].iter().zip(albedo.values[i]) {
                // Specular reflection adds a few percent.
                let (shown, diffuse) = (srgb::decode(*encoded), albedo * ao.values[i][0]);
                assert!((diffuse - 0.01..diffuse + 0.09).contains(&shown), "{shown} {diffuse}");
            }
        }
        assert!(seen > 20, "{seen}");
    }

    #[test]
    fn options_out_of_range_are_refused_by_name() {
        for (field, options) in [
            ("train_views", SyntheticOptions { train_views: 2, ..SyntheticOptions::default() }),
            ("size", SyntheticOptions { size: 0, ..SyntheticOptions::default() }),
            ("paths", SyntheticOptions { paths: 0, ..SyntheticOptions::default() }),
        ] {
            assert_eq!(synthetic(&options).unwrap_err().field(), Some(field));
        }
    }
}
