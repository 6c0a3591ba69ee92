//! A small path tracer with a seeded low-discrepancy sequence per pixel, so that the image does not depend on the
//! number of threads.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::scene::{AnalyticScene, Hit};
use super::shading::{LightSampler, SurfacePoint, sample_cosine, sample_mixture};
use super::sobol::{self, mix};
use relume_scene::{Camera, EnvMap};

/// Surface points on a path: the visible one and two bounces of indirect light.
const PATH_LENGTH: u64 = 3;
/// Paths per camera ray.
const PATHS_PER_RAY: u32 = 4;

/// Renders views of a scene under several lights at once.
pub(super) struct Tracer {
    scene: AnalyticScene,
    lights: Vec<EnvMap>,
    sampler: LightSampler,
    paths: u32,
    seed: u64,
    ambient_occlusion: AmbientOcclusion,
}

/// Whether ambient occlusion is estimated, which costs one more ray per path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum AmbientOcclusion {
    /// [`Pixel::ambient_occlusion`] stays 0.
    Off,
    On,
}

/// The values of one pixel; all but `coverage` are means over its covered part.
#[derive(Debug, Clone, Default)]
pub(super) struct Pixel {
    /// Share of the pixel that the scene covers.
    pub coverage: f64,
    /// Outgoing linear radiance under each light.
    pub radiance: Vec<DVec3>,
    pub albedo: DVec3,
    pub normal: DVec3,
    pub metallic_roughness: DVec2,
    pub ambient_occlusion: f64,
    /// Distance along the view axis.
    pub depth: f64,
}

impl Tracer {
    /// A tracer of `scene` under each of `lights`, with about `paths` paths per pixel.
    pub(super) fn new(
        scene: AnalyticScene,
        lights: Vec<EnvMap>,
        paths: u32,
        seed: u64,
        ambient_occlusion: AmbientOcclusion,
    ) -> Self {
        let sampler = LightSampler::new(&lights);
        Self { scene, sampler, lights, paths, seed, ambient_occlusion }
    }

    /// The pixels of a view, row-major. Views with different `stream` have independent noise.
    pub(super) fn render(&self, camera: &Camera, stream: u64) -> Vec<Pixel> {
        let count = camera.width * camera.height;
        (0..count).into_par_iter().map(|i| self.pixel(camera, stream, i)).collect()
    }

    fn pixel(&self, camera: &Camera, stream: u64, index: u32) -> Pixel {
        let (x, y) = (index % camera.width, index / camera.width);
        // One sequence for the image plane, one for ambient occlusion, and one per path vertex.
        let key = mix(self.seed ^ mix(stream ^ mix(u64::from(index))));
        let [in_pixel, in_sky, on_path] = [0, 1, 2].map(|d| mix(key ^ d));
        let mut sum = Pixel { radiance: vec![DVec3::ZERO; self.lights.len()], ..Pixel::default() };
        let points = self.paths.div_ceil(PATHS_PER_RAY);
        for point in 0..points {
            let at = DVec2::new(f64::from(x), f64::from(y)) + sobol::pair(point, in_pixel);
            let (origin, direction) = ray(camera, at);
            let Some(hit) = self.scene.intersect(origin, direction) else { continue };
            sum.coverage += 1.0;
            sum.albedo += hit.material.albedo;
            sum.normal += hit.normal;
            sum.metallic_roughness += DVec2::new(hit.material.metallic, hit.material.roughness);
            sum.depth += hit.distance * direction.dot(camera.forward());
            for path in point * PATHS_PER_RAY..(point + 1) * PATHS_PER_RAY {
                if self.ambient_occlusion == AmbientOcclusion::On {
                    let sky = sample_cosine(hit.normal, sobol::pair(path, in_sky));
                    sum.ambient_occlusion += f64::from(self.scene.intersect(hit.point, sky).is_none());
                }
                self.path(
                    hit,
                    -direction,
                    |vertex| sobol::pair(path, mix(on_path ^ vertex)),
                    &mut sum.radiance,
                );
            }
        }
        sum.averaged(f64::from(points))
    }

    /// Adds the radiance of one path under each light.
    fn path(&self, first: Hit, view: DVec3, numbers: impl Fn(u64) -> DVec2, radiance: &mut [DVec3]) {
        let (mut hit, mut view, mut throughput) = (first, view, DVec3::ONE);
        for vertex in 0..PATH_LENGTH {
            let surface = SurfacePoint { normal: hit.normal, view, material: hit.material };
            let (l, weight) = sample_mixture(&surface, &self.sampler, numbers(vertex));
            throughput *= weight;
            if throughput == DVec3::ZERO {
                return;
            }
            match self.scene.intersect(hit.point, l) {
                Some(next) => (hit, view) = (next, -l),
                None => {
                    for (sum, light) in radiance.iter_mut().zip(&self.lights) {
                        *sum += throughput * DVec3::from(light.sample(l).map(f64::from));
                    }
                    return;
                }
            }
        }
    }
}

impl Pixel {
    fn averaged(mut self, points: f64) -> Self {
        let hits = self.coverage;
        if hits == 0.0 {
            return self;
        }
        let paths = hits * f64::from(PATHS_PER_RAY);
        self.coverage = hits / points;
        self.radiance.iter_mut().for_each(|r| *r /= paths);
        self.albedo /= hits;
        self.normal = self.normal.normalize_or_zero();
        self.metallic_roughness /= hits;
        self.ambient_occlusion /= paths;
        self.depth /= hits;
        self
    }
}

/// Ray through a point of the image plane, pixels.
fn ray(camera: &Camera, at: DVec2) -> (DVec3, DVec3) {
    let d = DVec3::new((at.x - camera.cx) / camera.fx, (at.y - camera.cy) / camera.fy, 1.0);
    (camera.centre(), (camera.rotation.transpose() * d).normalize())
}
