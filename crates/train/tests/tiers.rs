//! The render tiers against each other: the gain of `high` over `standard`, and `monte_carlo` as the ground
//! truth.

use std::sync::{Arc, OnceLock};

use glam::DVec3;
use relume_compare::{largest_difference, rms_difference};
use relume_engine::cpu::{AttributeSource, Probes};
use relume_engine::{
    ColourMode, FrameJob, FrameLight as _, HostModel, ProbeSettings, RasterCamera, fibonacci_sphere,
};
use relume_scene::light::rendering_tables;
use relume_scene::{
    Camera, EnvMap, Field, Gaussians, IndirectForm, Model, ShadeAt, ShadingOptions, texel_directions,
};
use relume_spec::rendering::{Output, Quality, Tier};
use relume_train::render::{Frame, Renderer};

const SH_DEGREE: usize = 4;

/// A flat disc: centre, normal, standard deviation.
type Disc = (DVec3, DVec3, f64);

/// A model of opaque discs of one material; visibility is measured as in training.
fn model(discs: &[Disc], albedo: f32, rough_logit: f32) -> Arc<Model> {
    let mut g = Gaussians::zeroed(discs.len(), 1, SH_DEGREE, 0);
    for (i, (centre, normal, sigma)) in discs.iter().enumerate() {
        let turn = glam::DQuat::from_rotation_arc(DVec3::Z, *normal);
        let quaternion = [turn.w, turn.x, turn.y, turn.z].map(|v| v as f32);
        g.row_mut(Field::Mean, i).copy_from_slice(&centre.to_array().map(|v| v as f32));
        g.row_mut(Field::Quaternion, i).copy_from_slice(&quaternion);
        let wide = sigma.ln() as f32;
        g.row_mut(Field::LogScale, i).copy_from_slice(&[wide, wide, 1e-3f32.ln()]);
    }
    g.field_mut(Field::OpacityLogit).fill(6.0);
    g.field_mut(Field::MetalLogit).fill(-20.0);
    g.field_mut(Field::RoughLogit).fill(rough_logit);
    let options = ShadingOptions { indirect: IndirectForm::Off, ..ShadingOptions::default() };
    let prototypes = [[albedo; 3]];
    let source = AttributeSource::new(&g, &prototypes, &options);
    let probes = Probes::measure(&source, fibonacci_sphere(256), ProbeSettings::default());
    let coefficients = probes.coefficients(SH_DEGREE);
    g.field_mut(Field::Visibility).copy_from_slice(&coefficients);
    Arc::new(Model { shading: options, ..Model::new(g, vec![[albedo; 3]], vec![[0.0; 3]; 8], (4, 2)) })
}

/// `side` x `side` horizontal discs at height `z`, `spacing` apart.
fn plate(side: i32, spacing: f64, z: f64) -> impl Iterator<Item = Disc> {
    let middle = f64::from(side - 1) / 2.0;
    (0..side * side).map(move |i| {
        let at = |k: i32| (f64::from(k) - middle) * spacing;
        (DVec3::new(at(i % side), at(i / side), z), DVec3::Z, 0.8 * spacing)
    })
}

/// A plate over a floor.
pub(super) fn table() -> Arc<Model> {
    static MODEL: OnceLock<Arc<Model>> = OnceLock::new();
    let made = MODEL.get_or_init(|| {
        let discs: Vec<Disc> = plate(72, 0.03, 0.0).chain(plate(25, 0.025, 0.45)).collect();
        model(&discs, 0.6, 0.0)
    });
    made.clone()
}

/// A sun on one texel of a dim sky.
pub(super) fn sun() -> EnvMap {
    let towards = DVec3::new(0.5, 0.2, 0.85).normalize();
    let nearest = texel_directions(128, 64)
        .into_iter()
        .map(|(d, _)| d)
        .reduce(|a, b| if b.dot(towards) > a.dot(towards) { b } else { a })
        .unwrap();
    EnvMap::from_fn(128, 64, |d| if d == nearest { [1500.0, 1400.0, 1200.0] } else { [0.15, 0.2, 0.3] })
}

pub(super) fn camera(size: u32) -> Camera {
    Camera::look_at(DVec3::new(0.3, -2.0, 2.0), DVec3::ZERO, DVec3::Z, 0.5, (size, size)).unwrap()
}

fn frame(renderer: &Renderer, map: &EnvMap, quality: impl Into<Quality>, size: u32) -> Frame {
    seen_from(&camera(size), renderer, map, quality)
}

fn seen_from(camera: &Camera, renderer: &Renderer, map: &EnvMap, quality: impl Into<Quality>) -> Frame {
    let light = renderer.prepare_light(map).unwrap();
    let outputs = [Output::Rgb, Output::Diffuse, Output::Specular];
    renderer.render(camera, &light, quality, &outputs).unwrap()
}

/// The standard frame from tables of the whole map.
fn without_lights(model: &Arc<Model>, map: &EnvMap, size: u32) -> Frame {
    let light = Arc::new(HostModel::new(model.clone())).prepare_light(rendering_tables(map, SH_DEGREE));
    let job = FrameJob {
        view: RasterCamera::new(&camera(size), &model.shading),
        outputs: &[Output::Rgb, Output::Alpha, Output::Diffuse, Output::Specular],
        colour: ColourMode::WithGBuffer,
        depth_scale: 1.0,
    };
    light.render(&job).unwrap()
}

/// Root mean square difference of one output.
fn distance(a: &Frame, b: &Frame, output: Output) -> f64 {
    let distance = rms_difference(&a.planes[&output], &b.planes[&output]);
    assert!(distance.is_finite(), "{output:?}");
    distance
}

#[test]
fn separately_measured_sun_shadow_is_closer_to_the_reference() {
    let (map, even) = (sun(), EnvMap::constant(64, 32, [0.7; 3]));
    for shade_at in [ShadeAt::Gaussian, ShadeAt::Pixel] {
        let mut model = (*table()).clone();
        model.shading.shade_at = shade_at;
        let model = Arc::new(model);
        let soft = without_lights(&model, &map, 64);
        let renderer = Renderer::new(model);
        let truth = frame(&renderer, &map, Quality::monte_carlo(512), 64);
        let [standard, high] = [Tier::Standard, Tier::High].map(|tier| frame(&renderer, &map, tier, 64));
        let errors = [&soft, &standard, &high].map(|f| distance(f, &truth, Output::Diffuse));
        println!("{shade_at:?}: diffuse error: from tables alone, standard, high {errors:.4?}");
        assert!(errors[2] < 0.5 * errors[0], "{shade_at:?}: {errors:?}");
        // The standard tier measures shadows, one per Gaussian, only for models that are shaded at the
        // Gaussians.
        match shade_at {
            ShadeAt::Gaussian => assert!(errors[1] < 0.75 * errors[0] && errors[2] < 0.9 * errors[1]),
            ShadeAt::Pixel => assert!((errors[1] - errors[0]).abs() < 0.05 * errors[0]),
        }
        // Negative control: without a dominant light the two tiers are equal.
        let [standard, high] = [Tier::Standard, Tier::High].map(|tier| frame(&renderer, &even, tier, 48));
        assert!(distance(&standard, &high, Output::Rgb) < 1e-6, "{shade_at:?}");
    }
}

#[test]
fn high_tier_casts_shadows_on_parts_of_a_gaussian() {
    let discs = [(DVec3::ZERO, DVec3::Z, 4.0), (DVec3::new(0.0, 0.0, 0.45), DVec3::Z, 0.15)];
    for shade_at in [ShadeAt::Gaussian, ShadeAt::Pixel] {
        let mut model = (*model(&discs, 0.6, 0.0)).clone();
        model.shading.shade_at = shade_at;
        let renderer = Renderer::new(Arc::new(model));
        let dark = |tier: Tier| {
            let diffuse = frame(&renderer, &sun(), tier, 64).planes[&Output::Diffuse].clone();
            let brightest = diffuse.iter().copied().fold(0.0, f32::max);
            diffuse.chunks_exact(3).filter(|p| p[0] < 0.5 * brightest && p[0] > 0.0).count() as f64
                / (64.0 * 64.0)
        };
        let (standard, high) = (dark(Tier::Standard), dark(Tier::High));
        // Half of the light is blocked within 1.1 standard deviations, in an image of width 1.45, seen from
        // 45 degrees.
        assert!((0.01..0.06).contains(&high), "{shade_at:?}: {high}");
        assert!(standard < 0.3 * high, "the control, {shade_at:?}: {standard}");
    }
}

#[test]
fn colour_does_not_depend_on_other_requested_outputs() {
    let light = EnvMap::constant(64, 32, [0.9, 0.5, 0.2]);
    let camera = camera(48);
    let colour = |shade_at: ShadeAt, tier: Tier, outputs: &[Output]| {
        let mut model = (*table()).clone();
        model.shading.shade_at = shade_at;
        let renderer = Renderer::new(Arc::new(model));
        let light = renderer.prepare_light(&light).unwrap();
        renderer.render(&camera, &light, tier, outputs).unwrap()
    };
    let whole = colour(ShadeAt::Gaussian, Tier::Standard, &[Output::Rgb, Output::Diffuse, Output::Specular]);
    for tier in [Tier::Preview, Tier::Standard] {
        let alone = colour(ShadeAt::Gaussian, tier, &[Output::Rgb]);
        assert!(distance(&alone, &whole, Output::Rgb) < 1e-6, "{tier:?}");
    }
    let parts = whole.planes[&Output::Diffuse].iter().zip(&whole.planes[&Output::Specular]);
    let sums: Vec<f32> = parts.map(|(d, s)| d + s).collect();
    assert!(largest_difference(&sums, &whole.planes[&Output::Rgb]) < 1e-6);
    let deferred = colour(ShadeAt::Pixel, Tier::Standard, &[Output::Rgb]);
    assert!(distance(&deferred, &whole, Output::Rgb) > 1e-4, "the control");
}

#[test]
fn sheen_brightens_sun_and_sky_light_equally() {
    let discs: Vec<Disc> = plate(40, 0.05, 0.0).collect();
    let plain = model(&discs, 0.3, 0.0);
    let mut cloth = (*plain).clone();
    cloth.gaussians.field_mut(Field::Sheen).fill(1.0);
    let [plain, cloth] = [plain, Arc::new(cloth)].map(Renderer::new);
    let low = Camera::look_at(DVec3::new(0.0, -3.0, 0.9), DVec3::ZERO, DVec3::Z, 0.2, (16, 16)).unwrap();
    let gain = |tier: Tier| {
        let sum = |renderer: &Renderer| -> f32 {
            seen_from(&low, renderer, &sun(), tier).planes[&Output::Diffuse].iter().sum()
        };
        sum(&cloth) / sum(&plain)
    };
    // n . v is 0.29 in the middle of the image.
    let expected = 0.71f32.powi(3).exp();
    for tier in [Tier::Standard, Tier::High] {
        assert!((gain(tier) - expected).abs() < 0.03, "{tier:?}: {} against {expected}", gain(tier));
    }
    assert!(
        (gain(Tier::MonteCarlo) - 1.0).abs() < 1e-6,
        "the control: there is none where pixels are shaded"
    );
}

#[test]
fn unoccluded_white_surface_is_white_in_a_white_furnace() {
    let conserving = |model: Arc<Model>| {
        let shading = ShadingOptions { conserves_energy: true, ..model.shading };
        Renderer::new(Arc::new(Model { shading, ..Model::clone(&model) }))
    };
    let disc = model(&[(DVec3::ZERO, DVec3::Z, 1.5)], 1.0, 0.0);
    let renderer = conserving(disc.clone());
    let white = EnvMap::constant(32, 16, [1.0; 3]);
    let above = Camera::look_at(DVec3::Z * 3.0, DVec3::ZERO, DVec3::Y, 0.7, (24, 24)).unwrap();
    let mean = |renderer: &Renderer, map: &EnvMap, output: Output| {
        let shown = seen_from(&above, renderer, map, Quality::monte_carlo(256));
        let alpha: f32 = shown.planes[&Output::Alpha].iter().sum();
        shown.planes[&output].iter().sum::<f32>() / (3.0 * alpha)
    };
    let shown = mean(&renderer, &white, Output::Rgb);
    assert!((shown - 1.0).abs() < 1e-2, "{shown}");
    let uncoupled = mean(&Renderer::new(disc), &white, Output::Rgb);
    assert!(uncoupled > 1.015, "the control: {uncoupled}");
    let twice = mean(&renderer, &EnvMap::constant(32, 16, [2.0; 3]), Output::Rgb);
    assert!((twice / shown - 2.0).abs() < 1e-2, "{twice}");
    // Under a constant light the split sum is exact except for its table: both tiers show the same highlight.
    let standard = seen_from(&above, &renderer, &white, Tier::Standard);
    let alpha: f32 = standard.planes[&Output::Alpha].iter().sum();
    let total = standard.planes[&Output::Rgb].iter().sum::<f32>() / (3.0 * alpha);
    assert!((total - 1.0).abs() < 1e-2, "{total}");
    let tabled = standard.planes[&Output::Specular].iter().sum::<f32>() / (3.0 * alpha);
    let sampled = mean(&renderer, &white, Output::Specular);
    assert!((sampled / tabled - 1.0).abs() < 0.03, "sampled {sampled}, from the table {tabled}");
    // Negative control: a ball of discs hardly occludes itself; a floor under a plate is occluded
    // considerably.
    let open = mean(&conserving(ball()), &white, Output::Rgb);
    let hidden = mean(&Renderer::new(table()), &white, Output::Diffuse) / 0.6;
    assert!(open > 0.98 && open < 1.01, "{open}");
    assert!(hidden < 0.97, "{hidden}");
}

/// A white ball of discs.
fn ball() -> Arc<Model> {
    let disc = |d: [f32; 3]| {
        let n = DVec3::from_array(d.map(f64::from));
        (0.7 * n, n, 0.03)
    };
    model(&fibonacci_sphere(2500).into_iter().map(disc).collect::<Vec<_>>(), 1.0, 0.0)
}

#[test]
fn reference_converges_at_the_monte_carlo_rate() {
    let renderer = Renderer::new(table());
    let map = sun();
    let truth = frame(&renderer, &map, Quality { seed: 99, ..Quality::monte_carlo(2048) }, 24);
    let slope = |map: &EnvMap| {
        let point = |n: &u32| {
            let shown = frame(&renderer, map, Quality::monte_carlo(*n), 24);
            (f64::from(*n).ln(), distance(&shown, &truth, Output::Rgb).ln())
        };
        let points: Vec<(f64, f64)> = [4, 8, 16, 32, 64].iter().map(point).collect();
        let mean = |pick: fn(&(f64, f64)) -> f64| points.iter().map(pick).sum::<f64>() / 5.0;
        let (x, y) = (mean(|p| p.0), mean(|p| p.1));
        points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum::<f64>()
            / points.iter().map(|p| (p.0 - x).powi(2)).sum::<f64>()
    };
    let right = slope(&map);
    println!("error falls as n^{right:.3}");
    assert!((-0.6..-0.42).contains(&right), "{right}");
    // Negative control: under a light that is a third too strong the error stops falling.
    let wrong = slope(&map.rotated_and_scaled(0.0, 1.33));
    assert!(wrong > -0.35, "{wrong}");
}

#[test]
fn equal_seeds_give_equal_bytes_on_one_and_four_threads() {
    let run = |threads: usize, quality: Quality| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| frame(&Renderer::new(table()), &sun(), quality, 24))
    };
    for quality in [Quality::monte_carlo(8), Tier::High.into()] {
        assert!(run(1, quality) == run(4, quality), "{quality:?}");
    }
    let other = Quality { seed: 1, ..Quality::monte_carlo(8) };
    assert!(run(2, Quality::monte_carlo(8)) != run(2, other), "the control: another seed, other bytes");
    assert!(run(2, Tier::High.into()) == run(2, Quality { seed: 1, ..Tier::High.into() }));
}

#[test]
fn samples_out_of_range_are_refused_and_bright_lights_finite() {
    let renderer = Renderer::new(table());
    let light = renderer.prepare_light(sun()).unwrap();
    for samples in [0, Quality::MAX_SAMPLES + 1] {
        let refused = renderer.render(&camera(8), &light, Quality::monte_carlo(samples), &[Output::Rgb]);
        assert!(refused.unwrap_err().to_string().starts_with("samples: "));
    }
    let mut texels = vec![[0.0f32; 3]; 64 * 32];
    texels[300] = [1e30; 3];
    for map in [EnvMap::new(64, 32, texels).unwrap().0, EnvMap::constant(8, 4, [0.0; 3])] {
        for quality in [Tier::High.into(), Quality::monte_carlo(4), Quality::monte_carlo(1)] {
            let shown = frame(&renderer, &map, quality, 12);
            assert!(shown.planes.values().flatten().all(|v| v.is_finite()), "{quality:?}");
        }
    }
}
