//! The f64 reference's result.

use crate::parity::case::{ParityCase, ParityResult, VisibleSplat};
use crate::{Array, Gathered, Options, ReferenceModel, Stages, Tape, Var, forward};
use relume_engine::cpu::BufferGradient;

fn wide<const W: usize>(rows: &[[f32; W]]) -> Array {
    Array::from_rows(&rows.iter().map(|r| r.map(f64::from)).collect::<Vec<_>>())
}

fn options(case: &ParityCase<'_>) -> Options {
    let half = |from: usize| -> Vec<[f32; 3]> {
        case.gathered.iter().map(|g| std::array::from_fn(|c| g[from + c])).collect()
    };
    let gathered = (!case.gathered.is_empty())
        .then(|| Gathered { irradiance: wide(&half(0)), radiance: wide(&half(3)) });
    Options {
        background: case.background.map(f64::from),
        range: case.range,
        gathered,
        arriving: (!case.arriving.is_empty()).then(|| wide(case.arriving)),
        ..Options::model(case.model.shading, case.light.tables.clone())
    }
}

fn weigh<'t>(values: Var<'t>, weights: Array) -> Var<'t> {
    (values * values.tape().input(weights)).sum()
}

/// The result in f64. The model must have at least one Gaussian in front of the camera.
pub fn reference_result(case: &ParityCase<'_>) -> ParityResult {
    let tape = Tape::new();
    let pass = forward(&tape, &ReferenceModel::from_model(case.model), case.camera, &options(case));
    let buffer =
        |f: fn(&BufferGradient) -> f32| wide(&case.buffers.iter().map(|b| [f(b)]).collect::<Vec<_>>());
    let normals: Vec<[f32; 3]> = case.buffers.iter().map(|b| b.normal).collect();
    let b = &pass.buffer;
    let sum = weigh(pass.image, wide(&case.physical))
        + weigh(pass.radiance_image, wide(&case.radiance))
        + weigh(b.normal * b.coverage, wide(&normals))
        + weigh(b.plane * b.coverage, buffer(|b| b.plane))
        + weigh(b.metal * b.coverage, buffer(|b| b.metal))
        + weigh(b.rough * b.coverage, buffer(|b| b.rough))
        + weigh(b.coverage, buffer(|b| b.coverage));
    let rows = |v: Var<'_>| v.value().data().as_chunks::<3>().0.to_vec();
    ParityResult {
        physical: rows(pass.image),
        radiance: rows(pass.radiance_image),
        coverage: b.coverage.value().data().to_vec(),
        gradients: pass.parameters.gradients(&tape.gradients(sum)),
        splats: splats(&pass),
    }
}

fn splats(pass: &Stages<'_>) -> Vec<VisibleSplat> {
    let (pixels, conics) = (pass.splats.pixels.value(), pass.splats.conics.value());
    let seen = |(rank, gaussian): (usize, &usize)| VisibleSplat {
        gaussian: *gaussian,
        mean: std::array::from_fn(|k| pixels.row(rank)[k]),
        conic: std::array::from_fn(|k| conics.row(rank)[k]),
    };
    let mut out: Vec<VisibleSplat> = pass.splats.indices.iter().enumerate().map(seen).collect();
    out.sort_by_key(|s| s.gaussian);
    out
}

/// Pixels in which no splat is within `margin` (relative) of a threshold of alpha (1/255 and 0.99). In other pixels f32 may
/// fall on the other side of the threshold, which adds or removes a layer.
pub fn stable_pixels(case: &ParityCase<'_>, margin: f64) -> Vec<bool> {
    let tape = Tape::new();
    let pass = forward(&tape, &ReferenceModel::from_model(case.model), case.camera, &options(case));
    let logits = case.model.gaussians.field(relume_scene::Field::OpacityLogit);
    let compensation = pass.splats.compensation.value();
    let opacity: Vec<f64> = pass
        .splats
        .indices
        .iter()
        .enumerate()
        .map(|(rank, i)| {
            let factor =
                if case.model.shading.low_pass_compensation { compensation.row(rank)[0] } else { 1.0 };
            factor / (1.0 + (-f64::from(logits[*i])).exp())
        })
        .collect();
    let (means, conics) = (pass.splats.pixels.value(), pass.splats.conics.value());
    let width = case.camera.width as usize;
    (0..case.pixels())
        .map(|i| {
            let (x, y) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            opacity.iter().enumerate().all(|(rank, opacity)| {
                let (m, c) = (means.row(rank), conics.row(rank));
                let (dx, dy) = (x - m[0], y - m[1]);
                let power = 0.5 * (c[0] * dx * dx + c[2] * dy * dy) + c[1] * dx * dy;
                let alpha = opacity * (-power.max(0.0)).exp();
                (alpha * 255.0 - 1.0).abs() > margin && (alpha / 0.99 - 1.0).abs() > margin
            })
        })
        .collect()
}
