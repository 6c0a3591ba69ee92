//! The f32 CPU engine and the f64 reference compute the same function and the same gradients.

use std::sync::LazyLock;

use glam::DVec3;
use relume_compare::{largest_difference, relative_error, worst};
use relume_engine::cpu::{self, AttributeSource};
use relume_engine::{Gradients, ProbeSettings, fibonacci_sphere};
use relume_reference::parity::{LightShape, ParityCase, ParityResult, cpu_result, reference_result};
use relume_reference::{Array, Arrays, ENVIRONMENT, PROTOTYPES, Probes, ReferenceModel};
use relume_scene::light::TableResolution;
use relume_scene::{
    Camera, DiffuseForm, DisplayRange, Field, Gaussians, IndirectForm, LightSplit, MAX_LIGHTS, Model,
    NormalForm, ShadeAt, ShadingOptions, SplitLight, VisibilityForm, texel_directions,
};

pub(super) const GAUSSIANS: usize = 40;
pub(super) const SIZE: (u32, u32) = (37, 21);
pub(super) const BACKGROUND: [f32; 3] = [0.25, 0.5, 0.75];
/// Largest error relative to the largest value of an image; measured 1e-6.
const TOLERANCE_VALUE: f64 = 1e-5;
/// Largest error relative to the largest gradient of a parameter; measured 1e-5.
const TOLERANCE_GRADIENT: f64 = 1e-4;

static LIGHT: LazyLock<LightShape> = LazyLock::new(|| LightShape::new(32, 16, 4, TableResolution::TRAINING));

/// A reproducible stream of numbers in [-1, 1).
pub(super) struct Noise(pub(super) u64);

impl Noise {
    pub(super) fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / 8_388_608.0 - 1.0
    }

    pub(super) fn fill(&mut self, out: &mut [f32], centre: f32, spread: f32) {
        out.iter_mut().for_each(|v| *v = centre + spread * self.next());
    }
}

pub(super) fn model(seed: u64, shading: ShadingOptions) -> Model {
    let mut noise = Noise(seed);
    let mut gaussians = Gaussians::zeroed(GAUSSIANS, 5, 4, 2);
    let spreads = [
        (Field::Mean, 0.0, 0.9),
        (Field::LogScale, -1.8, 0.8),
        (Field::Quaternion, 0.0, 1.0),
        (Field::OpacityLogit, 0.5, 2.0),
        (Field::Normal, 0.0, 0.5),
        (Field::MetalLogit, -0.5, 2.0),
        (Field::RoughLogit, 0.0, 2.0),
        (Field::Sheen, 0.3, 0.8),
        (Field::ProtoLogits, 0.0, 2.0),
        (Field::Residual, 0.0, 0.1),
        (Field::Visibility, 0.0, 0.2),
        (Field::Indirect, 0.2, 0.3),
        (Field::Radiance, 0.0, 0.4),
    ];
    for (field, centre, spread) in spreads {
        noise.fill(gaussians.field_mut(field), centre, spread);
    }
    // The test cameras enlarge every second Gaussian.
    gaussians.field_mut(Field::SamplingRate).iter_mut().step_by(2).for_each(|rate| *rate = 3.0);
    // No photograph shows every ninth one.
    gaussians.field_mut(Field::SamplingRate).iter_mut().step_by(9).for_each(|rate| *rate = -3.0);
    gaussians.field_mut(Field::Visibility).iter_mut().step_by(25).for_each(|c| *c += 2.2);
    let mut triples = |count: usize, centre: f32, spread: f32| {
        let mut rows = vec![[0.0; 3]; count];
        noise.fill(rows.as_flattened_mut(), centre, spread);
        rows
    };
    Model { shading, ..Model::new(gaussians, triples(5, 0.5, 0.45), triples(512, -0.8, 1.0), (32, 16)) }
}

pub(super) fn wide<const W: usize>(rows: &[[f32; W]]) -> Array {
    Array::from_rows(&rows.iter().map(|r| r.map(f64::from)).collect::<Vec<_>>())
}

fn gathered_light(seed: u64) -> Vec<[f32; 6]> {
    let mut noise = Noise(seed ^ 0xf00d);
    (0..GAUSSIANS).map(|_| std::array::from_fn(|_| 0.2 + 0.1 * noise.next())).collect()
}

/// Results of the case `seed`: the CPU engine's and the reference's.
fn results(model: &Model, seed: u64) -> [ParityResult; 2] {
    let (camera, gathered) = (camera(seed), gathered_light(seed));
    let case =
        ParityCase { gathered: &gathered, ..ParityCase::new(model, &camera, BACKGROUND, &LIGHT, seed) };
    [cpu_result(&case), reference_result(&case)]
}

/// Three lights: one at the centre of its texels and as wide as they are, one point, one that is visible only from below.
pub(super) fn lights() -> LightSplit {
    let texels = texel_directions(32, 16);
    let radii = [0.15, 0.0, 0.05];
    let centres = [(4, 9), (6, 25), (14, 3)];
    let mut shares = vec![[0.0; MAX_LIGHTS]; 512];
    let mut lights = Vec::new();
    for (k, ((row, column), radius)) in centres.into_iter().zip(radii).enumerate() {
        let at = row * 32 + column;
        (at..at + 2).for_each(|t| shares[t][k] = 0.9);
        shares[at + 2][(k + 1) % 3] = 0.5;
        let direction = texels[at].0.to_array().map(|v| v as f32);
        lights.push(SplitLight { direction, radius });
    }
    LightSplit { lights, shares }
}

/// Results of the case `seed` with dominant lights that arrive in part, of both engines.
fn answers_with_lights(model: &Model, seed: u64, split: &LightSplit) -> [ParityResult; 2] {
    let (camera, gathered, light) = (camera(seed), gathered_light(seed), LIGHT.with_lights(split));
    let mut noise = Noise(seed ^ 0xbeef);
    let share = |k: usize, v: f32| if k == 1 { 1.0 } else { 0.5 + 0.5 * v };
    let arriving: Vec<[f32; MAX_LIGHTS]> =
        (0..GAUSSIANS).map(|_| std::array::from_fn(|k| share(k, noise.next()))).collect();
    let case = ParityCase {
        gathered: &gathered,
        arriving: &arriving,
        ..ParityCase::new(model, &camera, BACKGROUND, &light, seed)
    };
    [cpu_result(&case), reference_result(&case)]
}

#[test]
fn cpu_engine_matches_the_reference_with_separate_lights() {
    let split = lights();
    for seed in 1..=4 {
        let mut model = model(seed, ShadingOptions::default());
        // The texels of the lights are much brighter.
        let lit = split.shares.iter().zip(&mut model.env_raw).filter(|(m, _)| m.iter().any(|s| *s > 0.0));
        lit.for_each(|(_, raw)| *raw = raw.map(|v| v + 6.0));
        let [cpu, reference] = answers_with_lights(&model, seed, &split);
        let worst = image_error(&cpu.physical, &reference.physical);
        println!("lights {seed} image {worst:.1e}");
        assert!(worst < TOLERANCE_VALUE, "{seed}: {worst:e}");
        for (parameter, theirs) in &reference.gradients {
            let worst = distance(&cpu.gradients[parameter], theirs);
            println!("lights {seed} {parameter:14} {worst:.1e}");
            assert!(worst < TOLERANCE_GRADIENT, "{seed} {parameter}: {worst:e}");
        }
        // Negative control: the same environment without dominant lights gives another image.
        let [whole, _] = results(&model, seed);
        assert!(image_error(&whole.physical, &cpu.physical) > 10.0 * TOLERANCE_VALUE);
    }
}

/// The CPU engine's gradients by the reference's parameter names.
pub(super) fn as_arrays(model: &Model, found: &Gradients, by_raw: &[[f32; 3]]) -> Arrays {
    let mut gradients = Arrays::from([(PROTOTYPES, wide(&found.prototypes)), (ENVIRONMENT, wide(by_raw))]);
    for field in Field::ALL {
        let rows = (0..GAUSSIANS).flat_map(|i| found.get(field, i).iter().map(|v| f64::from(*v)));
        let shape = [GAUSSIANS, model.gaussians.width(field)];
        gradients.insert(field.name(), Array::new(&shape, rows.collect()));
    }
    gradients
}

/// Largest difference relative to the reference's largest value, at least 1e-6.
pub(super) fn distance(ours: &Array, reference: &Array) -> f64 {
    let largest = worst(reference.data().iter().map(|v| v.abs())).max(1e-6);
    assert!(largest.is_finite(), "the reference is not finite");
    largest_difference(ours.data(), reference.data()) / largest
}

pub(super) fn camera(seed: u64) -> Camera {
    let (sine, cosine) = (seed as f64 * 1.3).sin_cos();
    Camera::look_at(DVec3::new(3.0 * cosine, 3.0 * sine, 1.0), DVec3::ZERO, DVec3::Z, 0.6, SIZE).unwrap()
}

fn image_error(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    relative_error(a.as_flattened(), b.as_flattened())
}

fn engines_agree(name: &str, shading: ShadingOptions) {
    for seed in 1..=4 {
        let [cpu, reference] = results(&model(seed, shading), seed);
        let images = [(&cpu.physical, &reference.physical), (&cpu.radiance, &reference.radiance)];
        for worst in images.map(|(ours, theirs)| image_error(ours, theirs)) {
            println!("{name} {seed} image {worst:.1e}");
            assert!(worst < TOLERANCE_VALUE, "{name} {seed}: {worst:e}");
        }
        for (parameter, theirs) in &reference.gradients {
            let worst = distance(&cpu.gradients[parameter], theirs);
            println!("{name} {seed} {parameter:14} {worst:.1e}");
            assert!(worst < TOLERANCE_GRADIENT, "{name} {seed} {parameter}: {worst:e}");
        }
    }
}

/// One sigma of offset and of clearance, as in the reference.
const PLAIN: ProbeSettings =
    ProbeSettings { offset: 1.0, lift: 0.0, clearance: 1.0, bias: 0.0, reach: f32::INFINITY };

#[test]
fn cpu_engine_matches_the_reference_in_the_default_form() {
    engines_agree("default", ShadingOptions::default());
}

#[test]
fn cpu_engine_matches_the_reference_with_deferred_shading() {
    engines_agree("deferred", ShadingOptions { shade_at: ShadeAt::Pixel, ..ShadingOptions::default() });
}

#[test]
fn cpu_engine_matches_the_reference_with_learned_indirect_light() {
    for shade_at in [ShadeAt::Pixel, ShadeAt::Gaussian] {
        let indirect = IndirectForm::Learned;
        let shading = ShadingOptions { shade_at, indirect, ..ShadingOptions::default() };
        engines_agree(&format!("learned {shade_at:?}"), shading);
    }
}

#[test]
fn cpu_engine_matches_the_reference_with_ambient_occlusion() {
    let shading = ShadingOptions { diffuse: DiffuseForm::AmbientOcclusion, ..ShadingOptions::default() };
    engines_agree("ambient", shading);
}

#[test]
fn cpu_engine_matches_the_reference_if_it_conserves_energy() {
    for shade_at in [ShadeAt::Gaussian, ShadeAt::Pixel] {
        let shading = ShadingOptions { shade_at, conserves_energy: true, ..ShadingOptions::default() };
        engines_agree(&format!("conserving {shade_at:?}"), shading);
    }
}

#[test]
fn cpu_engine_matches_the_reference_in_the_article_form() {
    let shading = ShadingOptions {
        visibility: VisibilityForm::Sigmoid,
        diffuse: DiffuseForm::AmbientOcclusion,
        shade_at: ShadeAt::Pixel,
        normal: NormalForm::Free,
        low_pass_compensation: true,
        srgb: false,
        ..ShadingOptions::default()
    };
    engines_agree("article", shading);
}

#[test]
fn cpu_engine_matches_the_reference_without_visibility() {
    let shading = ShadingOptions {
        visibility: VisibilityForm::Off,
        indirect: IndirectForm::Off,
        ..ShadingOptions::default()
    };
    engines_agree("open", shading);
}

#[test]
fn cpu_engine_matches_the_reference_above_white() {
    for (seed, shade_at) in [(1, ShadeAt::Gaussian), (2, ShadeAt::Pixel)] {
        let mut model = model(seed, ShadingOptions { shade_at, ..ShadingOptions::default() });
        // Light that is several times as bright.
        model.env_raw.iter_mut().for_each(|raw| *raw = raw.map(|v| v + 12.0));
        let camera = camera(seed);
        let case = |range| ParityCase { range, ..ParityCase::new(&model, &camera, BACKGROUND, &LIGHT, seed) };
        let extended = case(DisplayRange::Extended);
        let [cpu, reference] = [cpu_result(&extended), reference_result(&extended)];
        let error = image_error(&cpu.physical, &reference.physical);
        assert!(error < TOLERANCE_VALUE, "{shade_at:?}: {error:e}");
        for (parameter, theirs) in &reference.gradients {
            let worst = distance(&cpu.gradients[parameter], theirs);
            println!("above white {shade_at:?} {parameter:14} {worst:.1e}");
            assert!(worst < TOLERANCE_GRADIENT, "{shade_at:?} {parameter}: {worst:e}");
        }
        assert!(worst(reference.physical.iter().flatten().copied()) > 1.5, "the case has pixels above white");
        let clipped = cpu_result(&case(DisplayRange::Unit));
        assert!(image_error(&clipped.physical, &reference.physical) > 0.1, "the control");
    }
}

#[test]
fn cpu_probes_match_the_reference() {
    let model = model(6, ShadingOptions::default());
    let source = AttributeSource::new(&model.gaussians, &model.prototypes, &model.shading);
    let directions = fibonacci_sphere(48);
    let normals = cpu::outward_normals(&source);
    let ours = cpu::Probes::measure(&source, directions.clone(), PLAIN);
    let scene = ReferenceModel::from_model(&model);
    let measure = |normals: &[[f32; 3]]| Probes::measure(&scene, &wide(normals), &wide(&directions), 1.0);
    let reference = measure(&normals);
    // The CPU engine treats a transmittance below 1e-3 as 0.
    let error =
        |reference: &Probes| {
            let pairs = (0..GAUSSIANS).flat_map(|i| (0..48).map(move |k| (i, k)));
            worst(pairs.map(|(i, k)| {
                (f64::from(ours.transmittance[k][i]) - reference.transmittance.row(i)[k]).abs()
            }))
        };
    let blocked = reference.transmittance.data().iter().filter(|t| **t < 0.5).count();
    assert!(blocked > 20, "the scene must occlude something: {blocked}");
    assert!(error(&reference) < 1.1e-3, "{}", error(&reference));
    let coefficients = reference.coefficients(4);
    let floats = ours.coefficients(4).into_iter().map(f64::from).collect();
    assert!(distance(&Array::new(&[GAUSSIANS, 25], floats), &coefficients) < 1e-3);
    let inside_out: Vec<[f32; 3]> = normals.iter().map(|n| n.map(|v| -v)).collect();
    let control = error(&measure(&inside_out));
    assert!(control.is_finite() && control > 0.05, "starting on the other side must be noticed: {control}");
}

#[test]
fn comparison_detects_another_model_and_shading_location() {
    let [cpu, reference] = results(&model(1, ShadingOptions::default()), 1);
    let mut rougher = model(1, ShadingOptions::default());
    rougher.gaussians.field_mut(Field::RoughLogit).iter_mut().for_each(|r| *r += 0.05);
    let [rougher, _] = results(&rougher, 1);
    assert!(image_error(&rougher.physical, &reference.physical) > TOLERANCE_VALUE);
    let normals = |result: &ParityResult| result.gradients["normals_raw"].clone();
    let control = distance(&normals(&rougher), &normals(&reference));
    assert!(control.is_finite() && control > TOLERANCE_GRADIENT, "{control}");
    let radiance = image_error(&rougher.radiance, &reference.radiance);
    assert!(radiance < TOLERANCE_VALUE, "the radiance branch has no roughness");
    let deferred = ShadingOptions { shade_at: ShadeAt::Pixel, ..ShadingOptions::default() };
    let [deferred, _] = results(&model(1, deferred), 1);
    assert!(image_error(&deferred.physical, &cpu.physical) > 10.0 * TOLERANCE_VALUE);
}
