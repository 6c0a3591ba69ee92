//! The CPU engine's result.

use crate::parity::case::{ParityCase, ParityResult, VisibleSplat};
use crate::{Array, Arrays, ENVIRONMENT, PROTOTYPES};
use relume_engine::cpu::{AttributeSource, BranchImages, Pass};
use relume_engine::{Gradients, RasterCamera, SurfaceShader, indirect_basis};
use relume_layout::channel::{COVERAGE, Channels};
use relume_layout::constants::EarlyStop;
use relume_scene::{Field, Model, softplus};

/// The result of the CPU engine, without early stop.
pub fn cpu_result(case: &ParityCase<'_>) -> ParityResult {
    let (model, operators) = (case.model, &case.light.operators);
    let radiance: Vec<[f32; 3]> = model.env_raw.iter().map(|t| t.map(softplus)).collect();
    let tables = operators.apply(&radiance);
    let source = AttributeSource {
        gathered: case.gathered,
        arriving: case.arriving,
        indirect_basis: &indirect_basis(&tables),
        ..AttributeSource::new(&model.gaussians, &model.prototypes, &model.shading)
    };
    let sh_degree = model.gaussians.visibility_degree();
    let shader = SurfaceShader { tables: &tables, options: &model.shading, sh_degree, range: case.range };
    let source = source.under(shader);
    let channels = Channels::Full(model.gaussians.width(Field::Visibility));
    let pass =
        Pass::forward(&source, RasterCamera::new(case.camera, &model.shading), channels, EarlyStop::Never);
    let images = shader.images(&pass, case.background);
    let by = BranchImages { physical: case.physical.clone(), radiance: case.radiance.clone() };
    let count = channels.count();
    let (by_gbuffer, mut by_tables) =
        shader.images_backward(&pass, case.background, &by, &case.buffers, count);
    let found = pass.backward(&source, &by_gbuffer, count.next_multiple_of(4), count, Some(&mut by_tables));
    let by_radiance = operators.apply_transposed(&by_tables);
    let by_raw: Vec<[f32; 3]> = by_radiance
        .iter()
        .zip(&model.env_raw)
        .map(|(g, raw)| std::array::from_fn(|c| g[c] / (1.0 + (-raw[c]).exp())))
        .collect();
    let width = pass.view.width;
    let coverage = |i| f64::from(pass.at(i % width, i / width, COVERAGE));
    let mut splats: Vec<VisibleSplat> = pass
        .splats
        .iter()
        .map(|s| VisibleSplat {
            gaussian: s.gaussian as usize,
            mean: s.mean.map(f64::from),
            conic: s.conic.map(f64::from),
        })
        .collect();
    splats.sort_by_key(|s| s.gaussian);
    ParityResult {
        physical: images.physical.iter().map(|p| p.map(f64::from)).collect(),
        radiance: images.radiance.iter().map(|p| p.map(f64::from)).collect(),
        coverage: (0..case.pixels()).map(coverage).collect(),
        gradients: arrays(model, &found, &by_raw),
        splats,
    }
}

/// Gradients by parameter name of the reference.
fn arrays(model: &Model, found: &Gradients, by_raw: &[[f32; 3]]) -> Arrays {
    let n = model.gaussians.len();
    let mut out = shared(model, found.prototypes.as_flattened(), by_raw.as_flattened());
    for field in Field::ALL {
        let rows = (0..n).flat_map(|i| found.get(field, i).iter().map(|v| f64::from(*v)));
        out.insert(field.name(), Array::new(&[n, model.gaussians.width(field)], rows.collect()));
    }
    out
}

/// Gradients of the parameters that all Gaussians share.
pub(super) fn shared(model: &Model, prototypes: &[f32], by_raw: &[f32]) -> Arrays {
    let wide = |shape: &[usize], v: &[f32]| Array::new(shape, v.iter().map(|v| f64::from(*v)).collect());
    Arrays::from([
        (PROTOTYPES, wide(&[model.prototypes.len(), 3], prototypes)),
        (ENVIRONMENT, wide(&[model.env_height, model.env_width, 3], by_raw)),
    ])
}
