//! `relume-bench precision`: the error of an f32 engine against the f64 reference, by stage and kind of scene.

use std::path::PathBuf;

use glam::DVec3;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use relume_compare::{largest_difference, relative_error, worst};

use crate::BoxError;
use relume_engine::cpu::objective::image::Target;
use relume_engine::gpu::objective::{ImageTerm, LOSS_SLOTS, LossSlot};
use relume_engine::gpu::{CameraUniform, DevicePhoto, Gpu, photo_pixel};
use relume_engine::{Device, DeviceChoice, DeviceError, ImageWeights, RasterCamera};
use relume_reference::parity::{
    LightShape, ParityCase, ParityResult, cpu_result, gpu_result, reference_result, stable_pixels,
};
use relume_reference::{Array, Tape, losses};
use relume_scene::light::TableResolution;
use relume_scene::{Camera, DisplayRange, Field, Gaussians, Model};

const SIZE: (u32, u32) = (24, 16);
const GAUSSIANS: usize = 24;
const ENVIRONMENT: (usize, usize) = (16, 8);
const SH_DEGREE: usize = 2;
/// Relative distance of a splat's alpha to a threshold below which a pixel is left out: an f32 engine may decide the
/// threshold differently without an error in its digits.
const MARGIN: f64 = 2e-3;
/// Weights of the image term (docs/MODEL.md section 5).
const IMAGE_WEIGHTS: [f32; 2] = [1.0, 0.25];

/// Options of `relume-bench precision`.
#[derive(Debug, clap::Args)]
pub(super) struct PrecisionArgs {
    /// The measured engine: `auto`, `cpu`, `gpu` or `gpu:N`.
    #[arg(long, default_value = "cpu")]
    device: DeviceChoice,
    /// First seed of the scenes.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Number of scenes of each kind.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u64).range(1..=1000))]
    scenes: u64,
    /// Markdown file for the report, which is also printed.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// Kinds of scenes that are difficult in f32.
#[derive(Debug, Clone, Copy, PartialEq)]
enum SceneKind {
    /// Soft Gaussians around the origin.
    Ordinary,
    /// Gaussians a thousand times as long as thick, larger than the image.
    Needles,
    /// The camera is a hundred thousand scene radii away.
    FarCamera,
    /// Nearly opaque flat Gaussians, most of them occluded.
    NearOpaque,
}

const KINDS: [(SceneKind, &str); 4] = [
    (SceneKind::Ordinary, "ordinary"),
    (SceneKind::Needles, "needles 1000 : 1"),
    (SceneKind::FarCamera, "camera 1e5 away"),
    (SceneKind::NearOpaque, "nearly opaque"),
];

const STAGES: [&str; 9] = [
    "projected mean, relative to the image width",
    "conic, relative to its largest entry",
    "coverage",
    "radiance branch (blending)",
    "shaded image",
    "gradient of L1 + SSIM with respect to the image",
    "gradients with respect to geometry",
    "gradients with respect to materials",
    "gradients with respect to light, visibility and radiance",
];

pub(super) fn run(args: &PrecisionArgs) -> Result<(), BoxError> {
    let device = Device::open(args.device)?;
    let resolution = TableResolution::TRAINING;
    let light = LightShape::new(ENVIRONMENT.0, ENVIRONMENT.1, SH_DEGREE, resolution);
    let mut columns = Vec::new();
    for (kind, name) in KINDS {
        eprintln!("{name}");
        let mut errors = [0.0f64; STAGES.len()];
        for seed in args.seed..args.seed + args.scenes {
            let found = measure(&device, &light, kind, seed)?;
            errors.iter_mut().zip(found).for_each(|(e, f)| *e = worst([*e, f]));
        }
        columns.push(errors);
    }
    let report = report(args, &device, &columns);
    println!("{report}");
    match &args.out {
        Some(path) => std::fs::write(path, &report).map_err(|e| format!("{}: {e}", path.display()).into()),
        None => Ok(()),
    }
}

fn report(args: &PrecisionArgs, device: &Device, columns: &[[f64; STAGES.len()]]) -> String {
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let names = KINDS.map(|(_, name)| name).join(" | ");
    let mut text = format!(
        "Device: {}; host with {threads} threads.\nLargest error against f64, relative to the largest value of the image or \
         parameter: seeds {} to {}, {GAUSSIANS} Gaussians, {}x{} pixels.\n\n| stage | {names} |\n|---|{}\n",
        device.name(),
        args.seed,
        args.seed + args.scenes - 1,
        SIZE.0,
        SIZE.1,
        "---:|".repeat(KINDS.len())
    );
    for (stage, name) in STAGES.iter().enumerate() {
        let errors = columns.iter().map(|c| format!("{:.1e}", c[stage]));
        text += &format!("| {name} | {} |\n", errors.collect::<Vec<_>>().join(" | "));
    }
    text
}

/// A model of this kind, and a camera that views it.
fn scene(kind: SceneKind, seed: u64) -> Result<(Model, Camera), BoxError> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut gaussians = Gaussians::zeroed(GAUSSIANS, 4, SH_DEGREE, 2);
    for (field, centre, spread) in [
        (Field::Mean, 0.0, 0.7),
        (Field::LogScale, -1.7, 0.7),
        (Field::Quaternion, 0.0, 1.0),
        (Field::OpacityLogit, if kind == SceneKind::NearOpaque { 6.0 } else { 0.3 }, 1.5),
        (Field::Normal, 0.0, 0.3),
        (Field::MetalLogit, -0.5, 1.5),
        (Field::RoughLogit, 0.0, 1.5),
        (Field::Sheen, 0.3, 0.8),
        (Field::ProtoLogits, 0.0, 1.5),
        (Field::Residual, 0.0, 0.1),
        (Field::Visibility, 0.0, 0.2),
        (Field::Radiance, 0.0, 0.3),
    ] {
        let values = gaussians.field_mut(field).iter_mut();
        values.for_each(|v| *v = centre + spread * rng.random_range(-1.0f32..1.0));
    }
    for i in 0..GAUSSIANS {
        gaussians.row_mut(Field::Visibility, i)[0] += 2.2;
        let scale = gaussians.row_mut(Field::LogScale, i);
        match kind {
            SceneKind::Needles => scale.copy_from_slice(&[2.3 + scale[0], -4.6 + scale[1], -4.6 + scale[2]]),
            SceneKind::NearOpaque => scale.copy_from_slice(&[1.2 + scale[0], 1.2 + scale[1], -4.0]),
            SceneKind::Ordinary | SceneKind::FarCamera => {}
        }
    }
    let mut triples = |count: usize, centre: f32| -> Vec<[f32; 3]> {
        let mut one = || centre + 0.4 * rng.random_range(-1.0f32..1.0);
        (0..count).map(|_| [one(), one(), one()]).collect()
    };
    let model = Model::new(
        gaussians,
        triples(4, 0.5),
        triples(ENVIRONMENT.0 * ENVIRONMENT.1, -0.6),
        (ENVIRONMENT.0, ENVIRONMENT.1),
    );
    let distance = if kind == SceneKind::FarCamera { 1e5 } else { 3.0 };
    let (sine, cosine) = (seed as f64 * 1.3).sin_cos();
    let eye = DVec3::new(cosine, sine, 0.3).normalize() * distance;
    let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 2.0 * (1.0 / distance).atan(), SIZE)?;
    Ok((model, camera))
}

/// The error of each of [`STAGES`] on one scene.
fn measure(
    device: &Device,
    light: &LightShape,
    kind: SceneKind,
    seed: u64,
) -> Result<[f64; STAGES.len()], BoxError> {
    let (model, camera) = scene(kind, seed)?;
    let mut case = ParityCase::new(&model, &camera, [0.25, 0.5, 0.75], light, seed);
    let kept = stable_pixels(&case, MARGIN);
    case.keep(&kept);
    let expected = reference_result(&case);
    let (found, loss) = match device {
        Device::Cpu => (cpu_result(&case), loss_gradient_cpu(&expected, seed)),
        Device::Gpu(gpu) => (gpu_result(gpu, &case)?, loss_gradient_gpu(gpu, &case, &expected, seed)?),
    };
    let [mean, conic] = projection_errors(&found, &expected);
    let steady = |rows: &[[f64; 3]]| -> Vec<f64> {
        rows.iter().zip(&kept).filter(|(_, kept)| **kept).flat_map(|(p, _)| *p).collect()
    };
    let covered = |a: &ParityResult| -> Vec<f64> {
        a.coverage.iter().zip(&kept).filter(|(_, kept)| **kept).map(|(c, _)| *c).collect()
    };
    let gradients = |names: &[&str]| {
        worst(names.iter().map(|n| relative_error(found.gradients[n].data(), expected.gradients[n].data())))
    };
    Ok([
        mean,
        conic,
        relative_error(&covered(&found), &covered(&expected)),
        relative_error(&steady(&found.radiance), &steady(&expected.radiance)),
        relative_error(&steady(&found.physical), &steady(&expected.physical)),
        relative_error(&loss, &loss_gradient_reference(&expected, seed)),
        gradients(&["means", "log_scales", "quats", "opacity_logit"]),
        gradients(&[
            "normals_raw",
            "metal_logit",
            "rough_logit",
            "sheen",
            "proto_logits",
            "residual",
            "prototypes",
        ]),
        gradients(&["occ_sh", "radiance_sh", "env_raw"]),
    ])
}

/// Largest errors of the projected means, in image widths, and of the conics, relative to their largest entry.
fn projection_errors(found: &ParityResult, expected: &ParityResult) -> [f64; 2] {
    let mut errors = [0.0f64; 2];
    if found.splats.is_empty() && !expected.splats.is_empty() {
        return [f64::INFINITY; 2];
    }
    for theirs in &expected.splats {
        // The engine does not draw Gaussians that no pixel shows.
        let Ok(at) = found.splats.binary_search_by_key(&theirs.gaussian, |s| s.gaussian) else { continue };
        let ours = &found.splats[at];
        let mean = largest_difference(&ours.mean, &theirs.mean) / f64::from(SIZE.0);
        let conic = relative_error(&ours.conic, &theirs.conic);
        errors = [worst([errors[0], mean]), worst([errors[1], conic])];
    }
    errors
}

/// A photograph of noise with 16-bit levels.
fn photograph(seed: u64) -> Vec<[f32; 3]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0xf070);
    (0..SIZE.0 * SIZE.1).map(|_| std::array::from_fn(|_| f32::from(rng.random::<u16>()) / 65_535.0)).collect()
}

/// The image for the image terms, the same for every engine.
fn rendered(result: &ParityResult) -> Vec<[f32; 3]> {
    result.physical.iter().map(|p| p.map(|v| v as f32)).collect()
}

fn loss_gradient_reference(expected: &ParityResult, seed: u64) -> Vec<f64> {
    let shape = [SIZE.1 as usize, SIZE.0 as usize, 3];
    let wide =
        |rows: &[[f32; 3]]| Array::new(&shape, rows.as_flattened().iter().map(|v| f64::from(*v)).collect());
    let tape = Tape::new();
    let (image, photo) = (tape.input(wide(&rendered(expected))), tape.input(wide(&photograph(seed))));
    let window = losses::gaussian_window(11, 1.5);
    let [l1, ssim] = IMAGE_WEIGHTS.map(f64::from);
    let total = losses::mean_absolute_error(image, photo) * l1
        + losses::structural_dissimilarity(image, photo, &window) * ssim;
    tape.gradients(total).of(image).data().to_vec()
}

fn loss_gradient_cpu(expected: &ParityResult, seed: u64) -> Vec<f64> {
    let pixels = photograph(seed);
    let target = Target::new(SIZE.0 as usize, SIZE.1 as usize, &pixels);
    let [l1, ssim] = IMAGE_WEIGHTS;
    let gradient = target.compare(&rendered(expected), ImageWeights { l1, ssim }).gradient;
    gradient.as_flattened().iter().map(|v| f64::from(*v)).collect()
}

fn loss_gradient_gpu(
    gpu: &Gpu,
    case: &ParityCase<'_>,
    expected: &ParityResult,
    seed: u64,
) -> Result<Vec<f64>, DeviceError> {
    let padded =
        |rows: &[[f32; 3]]| -> Vec<[f32; 4]> { rows.iter().map(|[r, g, b]| [*r, *g, *b, 1.0]).collect() };
    let pixels = (SIZE.0 * SIZE.1) as usize;
    let image = gpu.upload("image", &padded(&rendered(expected)))?;
    let range = DisplayRange::Unit;
    let photo: Vec<_> =
        padded(&photograph(seed)).into_iter().map(|pixel| photo_pixel(pixel, range)).collect();
    let photo = DevicePhoto { pixels: gpu.upload("photograph", &photo)?, range };
    let partials = gpu.buffer("partials", 3 * pixels)?;
    let by_image = gpu.buffer("by image", pixels)?;
    let losses = gpu.buffer("losses", LOSS_SLOTS)?;
    let view = CameraUniform::new(&RasterCamera::new(case.camera, &case.model.shading));
    let [l1, ssim] = IMAGE_WEIGHTS;
    let term = ImageTerm {
        camera: &view,
        image: &image,
        photo: &photo,
        slot: LossSlot::PhysicalL1,
        weights: ImageWeights { l1, ssim },
        partials: &partials,
    };
    let mut recorder = gpu.record();
    recorder.clear(&losses);
    term.record(&mut recorder, &by_image, &losses);
    recorder.submit()?;
    let rows: Vec<[f32; 4]> = gpu.read(&by_image, 0..pixels)?;
    Ok(rows.iter().flat_map(|p| [p[0], p[1], p[2]]).map(f64::from).collect())
}
