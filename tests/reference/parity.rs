//! The f32 CPU engine and the f64 reference are the same function, and so are their gradients.

use glam::DVec3;
use relume::engine::Gradients;
use relume::engine::channel::Channels;
use relume::engine::constants::EarlyStop;
use relume::engine::cpu::{self, AttributeSource, BranchImages, BufferGradient, Pass, SurfaceShader};
use relume::engine::reference::{
    Array, Arrays, ENVIRONMENT, Gathered, Options, PROTOTYPES, Probes, ReferenceModel, TableOperators, Tape,
    Var, forward,
};
use relume::engine::{ProbeSettings, RasterCamera, fibonacci_sphere, indirect_basis};
use relume::light::{EnvOperators, TableResolution};
use relume::scene::{
    Camera, DiffuseForm, Field, Gaussians, IndirectForm, Model, NormalForm, ShadeAt, ShadingOptions,
    VisibilityForm, softplus,
};

pub(super) const GAUSSIANS: usize = 40;
pub(super) const SIZE: (u32, u32) = (37, 21);
pub(super) const BACKGROUND: [f32; 3] = [0.25, 0.5, 0.75];
/// Relative to the largest value of an image; measured 1e-6.
const TOLERANCE_VALUE: f64 = 1e-5;
/// Relative to the largest gradient of a parameter; measured 1e-5.
const TOLERANCE_GRADIENT: f64 = 1e-4;

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
    gaussians.field_mut(Field::Visibility).iter_mut().step_by(25).for_each(|c| *c += 2.2);
    let mut triples = |count: usize, centre: f32, spread: f32| {
        let mut rows = vec![[0.0; 3]; count];
        noise.fill(rows.as_flattened_mut(), centre, spread);
        rows
    };
    Model {
        gaussians,
        prototypes: triples(5, 0.5, 0.45),
        env_raw: triples(512, -0.8, 1.0),
        env_width: 32,
        env_height: 16,
        shading,
        world_scale: 1.0,
        world_offset: DVec3::ZERO,
        card: serde_json::Value::Null,
    }
}

/// What both engines are asked for: images, and the gradient of a fixed linear functional of them.
struct Answer {
    physical: Array,
    radiance: Array,
    gradients: Arrays,
}

/// The functional: weights of both images' pixels and of the normal, plane and metalness buffers.
struct Functional {
    physical: Vec<[f32; 3]>,
    radiance: Vec<[f32; 3]>,
    buffers: Vec<BufferGradient>,
}

impl Functional {
    fn new(seed: u64) -> Self {
        let mut noise = Noise(seed ^ 0x5eed);
        let pixels = (SIZE.0 * SIZE.1) as usize;
        let triples =
            |noise: &mut Noise| (0..pixels).map(|_| [noise.next(), noise.next(), noise.next()]).collect();
        let physical = triples(&mut noise);
        let radiance = triples(&mut noise);
        let normals: Vec<[f32; 3]> = triples(&mut noise);
        let buffers = normals.into_iter().map(|normal| BufferGradient {
            normal,
            plane: noise.next(),
            metal: noise.next(),
            rough: noise.next(),
            coverage: noise.next(),
        });
        Self { physical, radiance, buffers: buffers.collect() }
    }
}

pub(super) fn wide<const W: usize>(rows: &[[f32; W]]) -> Array {
    Array::from_rows(&rows.iter().map(|r| r.map(f64::from)).collect::<Vec<_>>())
}

fn gathered_light(seed: u64) -> Vec<[f32; 6]> {
    let mut noise = Noise(seed ^ 0xf00d);
    (0..GAUSSIANS).map(|_| std::array::from_fn(|_| 0.2 + 0.1 * noise.next())).collect()
}

fn weigh<'t>(values: Var<'t>, weights: Array) -> Var<'t> {
    (values * values.tape().input(weights)).sum()
}

fn by_reference(model: &Model, camera: &Camera, gathered: &[[f32; 6]], functional: &Functional) -> Answer {
    let half = |from: usize| -> Vec<[f32; 3]> {
        gathered.iter().map(|g| std::array::from_fn(|c| g[from + c])).collect()
    };
    let tables = TableOperators::new(32, 16, TableResolution::TRAINING);
    let options = Options {
        background: BACKGROUND.map(f64::from),
        gathered: Some(Gathered { irradiance: wide(&half(0)), radiance: wide(&half(3)) }),
        ..Options::model(model.shading, tables)
    };
    let tape = Tape::new();
    let pass = forward(&tape, &ReferenceModel::from_model(model), camera, &options);
    let buffer =
        |f: fn(&BufferGradient) -> f32| wide(&functional.buffers.iter().map(|b| [f(b)]).collect::<Vec<_>>());
    let normals: Vec<[f32; 3]> = functional.buffers.iter().map(|b| b.normal).collect();
    let b = &pass.buffer;
    let sum = weigh(pass.image, wide(&functional.physical))
        + weigh(pass.radiance_image, wide(&functional.radiance))
        + weigh(b.normal * b.coverage, wide(&normals))
        + weigh(b.plane * b.coverage, buffer(|b| b.plane))
        + weigh(b.metal * b.coverage, buffer(|b| b.metal))
        + weigh(b.rough * b.coverage, buffer(|b| b.rough))
        + weigh(b.coverage, buffer(|b| b.coverage));
    Answer {
        physical: (*pass.image.value()).clone(),
        radiance: (*pass.radiance_image.value()).clone(),
        gradients: pass.parameters.gradients(&tape.gradients(sum)),
    }
}

fn by_cpu(model: &Model, camera: &Camera, gathered: &[[f32; 6]], functional: &Functional) -> Answer {
    let operators = EnvOperators::new(32, 16, 4, TableResolution::TRAINING);
    let radiance: Vec<[f32; 3]> = model.env_raw.iter().map(|t| t.map(softplus)).collect();
    let tables = operators.apply(&radiance);
    let source = AttributeSource {
        gaussians: &model.gaussians,
        prototypes: &model.prototypes,
        options: &model.shading,
        gathered,
        indirect_basis: &indirect_basis(&tables),
        light: None,
    };
    let shader = SurfaceShader { tables: &tables, options: &model.shading, order: 4 };
    let source = source.under(shader);
    let channels = Channels::Full(25);
    let pass = Pass::forward(&source, RasterCamera::new(camera, &model.shading), channels, EarlyStop::Never);
    let images = shader.images(&pass, BACKGROUND);
    let by = BranchImages { physical: functional.physical.clone(), radiance: functional.radiance.clone() };
    let count = channels.count();
    let (by_gbuffer, mut by_tables) =
        shader.images_backward(&pass, BACKGROUND, &by, &functional.buffers, count);
    let stored = count.next_multiple_of(4);
    let found = pass.backward(&source, &by_gbuffer, stored, count, Some(&mut by_tables));
    let by_radiance = operators.apply_transposed(&by_tables);
    let by_raw: Vec<[f32; 3]> = by_radiance
        .iter()
        .zip(&model.env_raw)
        .map(|(g, raw)| std::array::from_fn(|c| g[c] / (1.0 + (-raw[c]).exp())))
        .collect();
    Answer {
        physical: wide(&images.physical),
        radiance: wide(&images.radiance),
        gradients: as_arrays(model, &found, &by_raw),
    }
}

/// The CPU engine's gradients under the reference's names.
pub(super) fn as_arrays(model: &Model, found: &Gradients, by_raw: &[[f32; 3]]) -> Arrays {
    let mut gradients = Arrays::from([(PROTOTYPES, wide(&found.prototypes)), (ENVIRONMENT, wide(by_raw))]);
    for field in Field::ALL {
        let rows = (0..GAUSSIANS).flat_map(|i| found.get(field, i).iter().map(|v| f64::from(*v)));
        let shape = [GAUSSIANS, model.gaussians.width(field)];
        gradients.insert(field.name(), Array::new(&shape, rows.collect()));
    }
    gradients
}

/// Largest difference relative to the reference's largest value.
pub(super) fn distance(ours: &Array, reference: &Array) -> f64 {
    let largest = reference.data().iter().fold(1e-6, |m: f64, v| m.max(v.abs()));
    let differences = ours.data().iter().zip(reference.data()).map(|(a, b)| (a - b).abs() / largest);
    differences.fold(0.0, |worst, d| if d > worst || d.is_nan() { d } else { worst })
}

pub(super) fn camera(seed: u64) -> Camera {
    let (sine, cosine) = (seed as f64 * 1.3).sin_cos();
    Camera::look_at(DVec3::new(3.0 * cosine, 3.0 * sine, 1.0), DVec3::ZERO, DVec3::Z, 0.6, SIZE).unwrap()
}

fn engines_agree(name: &str, shading: ShadingOptions) {
    for seed in 1..=4 {
        let (model, camera, gathered) = (model(seed, shading), camera(seed), gathered_light(seed));
        let functional = Functional::new(seed);
        let reference = by_reference(&model, &camera, &gathered, &functional);
        let cpu = by_cpu(&model, &camera, &gathered, &functional);
        let images = [(&cpu.physical, &reference.physical), (&cpu.radiance, &reference.radiance)];
        for (ours, theirs) in images {
            let worst = distance(ours, theirs);
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

/// One sigma of offset and of clearance, as the reference has it.
const PLAIN: ProbeSettings =
    ProbeSettings { offset: 1.0, lift: 0.0, clearance: 1.0, bias: 0.0, reach: f32::INFINITY };

#[test]
fn the_cpu_engine_is_the_reference_in_the_default_form() {
    engines_agree("default", ShadingOptions::default());
}

#[test]
fn the_cpu_engine_is_the_reference_where_pixels_are_shaded() {
    engines_agree("deferred", ShadingOptions { shade_at: ShadeAt::Pixel, ..ShadingOptions::default() });
}

#[test]
fn the_cpu_engine_is_the_reference_with_learned_indirect_light() {
    for shade_at in [ShadeAt::Pixel, ShadeAt::Gaussian] {
        let indirect = IndirectForm::Learned;
        let shading = ShadingOptions { shade_at, indirect, ..ShadingOptions::default() };
        engines_agree(&format!("learned {shade_at:?}"), shading);
    }
}

#[test]
fn the_cpu_engine_is_the_reference_with_ambient_occlusion_at_the_gaussians() {
    let shading = ShadingOptions { diffuse: DiffuseForm::AmbientOcclusion, ..ShadingOptions::default() };
    engines_agree("ambient", shading);
}

#[test]
fn where_surfaces_are_shaded_makes_a_difference() {
    let at = |shade_at| {
        let shading = ShadingOptions { shade_at, ..ShadingOptions::default() };
        let light = gathered_light(1);
        by_cpu(&model(1, shading), &camera(1), &light, &Functional::new(1)).physical
    };
    let difference = distance(&at(ShadeAt::Pixel), &at(ShadeAt::Gaussian));
    assert!(difference > 10.0 * TOLERANCE_VALUE, "{difference:e}");
}

#[test]
fn the_cpu_engine_is_the_reference_in_the_article_form_on_tables() {
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
fn the_cpu_engine_is_the_reference_without_visibility() {
    let shading = ShadingOptions {
        visibility: VisibilityForm::Off,
        indirect: IndirectForm::Off,
        ..ShadingOptions::default()
    };
    engines_agree("open", shading);
}

#[test]
fn the_cpu_engines_probes_see_what_the_references_see() {
    let model = model(6, ShadingOptions::default());
    let source = AttributeSource {
        gaussians: &model.gaussians,
        prototypes: &model.prototypes,
        options: &model.shading,
        gathered: &[],
        indirect_basis: &[[0.0; 3]; 16],
        light: None,
    };
    let directions = fibonacci_sphere(48);
    let normals = cpu::outward_normals(&source);
    let ours = cpu::Probes::measure(&source, directions.clone(), PLAIN);
    let scene = ReferenceModel::from_model(&model);
    let measure = |normals: &[[f32; 3]]| Probes::measure(&scene, &wide(normals), &wide(&directions), 1.0);
    let reference = measure(&normals);
    // The CPU engine calls a transmittance below 1e-3 opaque.
    let worst = |reference: &Probes| {
        let pairs = (0..GAUSSIANS).flat_map(|i| (0..48).map(move |k| (i, k)));
        let error = |(i, k): (usize, usize)| {
            (f64::from(ours.transmittance[k][i]) - reference.transmittance.row(i)[k]).abs()
        };
        pairs.map(error).fold(0.0, f64::max)
    };
    let blocked = reference.transmittance.data().iter().filter(|t| **t < 0.5).count();
    assert!(blocked > 20, "the scene must occlude something: {blocked}");
    assert!(worst(&reference) < 1.1e-3, "{}", worst(&reference));
    let coefficients = reference.coefficients(4);
    let floats = ours.coefficients(4).into_iter().map(f64::from).collect();
    assert!(distance(&Array::new(&[GAUSSIANS, 25], floats), &coefficients) < 1e-3);
    let inside_out: Vec<[f32; 3]> = normals.iter().map(|n| n.map(|v| -v)).collect();
    assert!(worst(&measure(&inside_out)) > 0.05, "starting on the other side must be noticed");
}

#[test]
fn the_comparison_of_engines_notices_another_model() {
    let (camera, gathered, functional) = (camera(1), gathered_light(1), Functional::new(1));
    let reference = by_reference(&model(1, ShadingOptions::default()), &camera, &gathered, &functional);
    let mut other = model(1, ShadingOptions::default());
    other.gaussians.field_mut(Field::RoughLogit).iter_mut().for_each(|r| *r += 0.05);
    let cpu = by_cpu(&other, &camera, &gathered, &functional);
    assert!(distance(&cpu.physical, &reference.physical) > TOLERANCE_VALUE);
    assert!(
        distance(&cpu.gradients["normals_raw"], &reference.gradients["normals_raw"]) > TOLERANCE_GRADIENT
    );
    assert!(
        distance(&cpu.radiance, &reference.radiance) < TOLERANCE_VALUE,
        "the radiance branch has no roughness"
    );
}
