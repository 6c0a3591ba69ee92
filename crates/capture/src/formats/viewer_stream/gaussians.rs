//! The Gaussians of a model in the form that a viewer shades and draws.

use serde_json::{Map, Value, json};

use crate::formats::splats::albedo;
use crate::formats::viewer_stream::encode;
use crate::formats::viewer_stream::quantity::Quantity;
use relume_scene::{Field, Framing, Gaussians, Model, NormalForm, PhotographedViews};

const MAGIC: [u8; 4] = *b"RLMG";
/// Greatest magnitude of a logit; larger ones display as 0 or 1.
const MAX_LOGIT: f32 = 12.0;
/// Greatest magnitude of sheen that has an effect (docs/MODEL.md section 1).
const MAX_SHEEN: f32 = 3.0;
/// Greatest magnitude of the logarithm of a standard deviation when drawn.
const MAX_LOG_SCALE: f32 = 60.0;

/// Indices of the Gaussians that frames show, by decreasing importance: opacity times the area of the broadest side; ties by index.
pub fn importance_order(g: &Gaussians) -> Vec<usize> {
    let importance: Vec<f32> = (0..g.len())
        .map(|i| {
            let mut scales = g.get::<3>(Field::LogScale, i).map(|s| s.clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE));
            scales.sort_by(f32::total_cmp);
            let area = scales[1] + scales[2];
            // Computed in logarithms, which do not overflow.
            area - (-g.row(Field::OpacityLogit, i)[0]).clamp(-80.0, 80.0).exp().ln_1p()
        })
        .collect();
    let mut order: Vec<usize> = (0..g.len()).filter(|i| g.is_photographed(*i)).collect();
    order.sort_by(|a, b| importance[*b].total_cmp(&importance[*a]).then(a.cmp(b)));
    order
}

/// The stream of a model's Gaussians. `framing` is the viewer's initial view.
pub fn encode_gaussians(model: &Model, framing: &Framing) -> Vec<u8> {
    let g = &model.gaussians;
    let order = importance_order(g);
    let column = |field: Field, most: f32| -> Vec<f32> {
        order.iter().flat_map(|&i| g.row(field, i)).map(|v| v.clamp(-most, most)).collect()
    };
    let rows = |row: &dyn Fn(usize) -> [f32; 3]| -> Vec<f32> { order.iter().flat_map(|&i| row(i)).collect() };
    let (bounds, log_scales) = separated(column(Field::LogScale, MAX_LOG_SCALE));
    let coefficients = g.width(Field::Visibility);
    let records = [
        Quantity::full("mean", 3, column(Field::Mean, f32::MAX)),
        Quantity::fine_within("log_scale", 3, bounds, log_scales),
        Quantity::fine_within(
            "quaternion",
            4,
            [-1.0, 1.0],
            order.iter().flat_map(|&i| rotation(g, i)).collect(),
        ),
        Quantity::fine("opacity", 1, column(Field::OpacityLogit, MAX_LOGIT)),
        Quantity::half("normal", 3, rows(&|i| normal(model, i))),
        Quantity::fine("metal", 1, column(Field::MetalLogit, MAX_LOGIT)),
        Quantity::fine("rough", 1, column(Field::RoughLogit, MAX_LOGIT)),
        Quantity::fine("sheen", 1, column(Field::Sheen, MAX_SHEEN)),
        Quantity::half("sampling_rate", 1, column(Field::SamplingRate, f32::MAX)),
        Quantity::fine("albedo", 3, rows(&|i| albedo(model, i))),
        Quantity::coarse("visibility", coefficients, column(Field::Visibility, f32::MAX)),
    ];
    encode(MAGIC, facts(model, framing), &[], &records)
}

fn facts(model: &Model, framing: &Framing) -> Map<String, Value> {
    let mut facts = Map::from_iter([
        ("shading".to_owned(), json!(model.shading)),
        ("world_scale".to_owned(), json!(model.world_scale)),
        ("world_offset".to_owned(), json!(model.world_offset.to_array())),
        ("up".to_owned(), json!([0, 0, 1])),
        ("framing".to_owned(), json!(framing)),
    ]);
    if let Some(views) = PhotographedViews::of_card(&model.card) {
        facts.insert("photographed_views".to_owned(), json!(views));
    }
    facts
}

/// Unit quaternion; the identity for a quaternion of length 0.
fn rotation(g: &Gaussians, i: usize) -> [f32; 4] {
    let q = g.get::<4>(Field::Quaternion, i);
    let length = q.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
    if length > 1e-12 { q.map(|v| (f64::from(v) / length) as f32) } else { [1.0, 0.0, 0.0, 0.0] }
}

/// The normal field, shortened where its length would exceed the precision of half floats.
fn normal(model: &Model, i: usize) -> [f32; 3] {
    let raw = model.gaussians.get::<3>(Field::Normal, i);
    let length = raw.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
    let most = match model.shading.normal {
        NormalForm::Free => 1.0,
        // At this length the axis of length 1 no longer affects the direction.
        NormalForm::ShortestAxis => 1e4,
    };
    let is_kept = length <= most && model.shading.normal == NormalForm::ShortestAxis;
    if is_kept || length <= 1e-12 { raw } else { raw.map(|v| (f64::from(v) / length * most) as f32) }
}

/// Log-scales `[Gaussian][3]` and their bounds. The shortest axis, which gives the normal, stays the shortest after
/// quantisation to 65,536 steps.
fn separated(mut log_scales: Vec<f32>) -> ([f32; 2], Vec<f32>) {
    let low = log_scales.iter().copied().reduce(f32::min).unwrap_or(0.0);
    let high = log_scales.iter().copied().reduce(f32::max).unwrap_or(0.0);
    let step = (high - low).max(0.01) / 65000.0;
    for scales in log_scales.as_chunks_mut::<3>().0 {
        let mut shortest = 0;
        (1..3).for_each(|k| shortest = if scales[k] < scales[shortest] { k } else { shortest });
        let others = (0..3).filter(|k| *k != shortest).map(|k| scales[k]);
        let next = others.fold(f32::INFINITY, f32::min);
        scales[shortest] = scales[shortest].min(next - 1.5 * step);
    }
    ([low - 2.0 * step, (high).max(low + 65000.0 * step)], log_scales)
}
