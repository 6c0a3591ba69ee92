//! Density control: plans where Gaussians are added and dropped, up to a budget.
//!
//! The signal is that of AbsGS: the magnitude of the gradient by the projected mean, summed pixel by pixel. The
//! budget goes to the Gaussians with the largest signal. Each of them splits in two along its longest axis. There is
//! one rule without random draws, and the rendered image hardly changes.

mod order;

use relume_engine::{DensityPlan, DensitySignals, PlannedGaussian, SplitOrigin, sigmoid};

/// Mean absgrad (half image widths) above which a Gaussian may be split.
const SPLIT_ABSGRAD: f32 = 4e-4;
/// Opacity below which a Gaussian is dropped.
const MIN_OPACITY: f32 = 0.008;
/// Standard deviation above which a Gaussian is dropped, scene radii.
const MAX_SCALE: f32 = 0.5;
/// Distance to a camera below which a Gaussian is dropped in captures without masks, scene radii.
const CAMERA_CLEARANCE: f32 = 0.2;
/// Largest growth of one round, as a share of the Gaussians.
const MAX_GROWTH: f32 = 0.25;

/// Drops Gaussians of low opacity or excessive size, and splits those with the largest absgrad while the budget
/// lasts. The new Gaussians have the order of [`order`]; if `signals` has no means, they have the order of their
/// sources, with second halves last.
///
/// `camera_centres` (normalised world) are given for scenes without masks. Such a scene keeps its large background
/// Gaussians, and drops those close in front of a camera, which no other view can correct; `signals` must then have
/// the means.
pub fn plan(signals: &DensitySignals, budget: usize, camera_centres: Option<&[[f32; 3]]>) -> DensityPlan {
    let n = signals.opacity_logits.len();
    let stats = &signals.stats;
    let kept: Vec<usize> = (0..n).filter(|&i| !is_dropped(signals, i, camera_centres)).collect();
    let growth = budget.saturating_sub(kept.len()).min((kept.len() as f32 * MAX_GROWTH) as usize + 8);
    let mut candidates: Vec<(f32, usize)> = kept
        .iter()
        .map(|&i| (stats.absgrad[i] / stats.seen[i].max(1.0), i))
        .filter(|(absgrad, _)| *absgrad > SPLIT_ABSGRAD)
        .collect();
    candidates.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    candidates.truncate(growth);
    let mut is_split = vec![false; n];
    candidates.iter().for_each(|&(_, i)| is_split[i] = true);
    let planned = |i: &usize, origin| PlannedGaussian { source: *i as u32, origin };
    let first = |i| planned(i, if is_split[*i] { SplitOrigin::UpperHalf } else { SplitOrigin::Keep });
    let second = |i| planned(i, SplitOrigin::LowerHalf);
    let halves = kept.iter().filter(|i| is_split[**i]).map(second);
    let mut gaussians: Vec<PlannedGaussian> = kept.iter().map(first).chain(halves).collect();
    let codes = order::morton_codes(&signals.means);
    // The sort is stable, so the halves of a Gaussian keep their order.
    gaussians.sort_by_key(|planned| codes.get(planned.source as usize).copied());
    DensityPlan { gaussians }
}

fn is_dropped(signals: &DensitySignals, i: usize, camera_centres: Option<&[[f32; 3]]>) -> bool {
    let largest = signals.log_scales[i].into_iter().fold(f32::NEG_INFINITY, f32::max);
    let is_misplaced = match camera_centres {
        None => largest > MAX_SCALE.ln(),
        Some(centres) => {
            let mean = signals.means[i];
            let is_near = |centre: &[f32; 3]| {
                (0..3).map(|k| (mean[k] - centre[k]).powi(2)).sum::<f32>() < CAMERA_CLEARANCE.powi(2)
            };
            centres.iter().any(is_near)
        }
    };
    sigmoid(signals.opacity_logits[i]) < MIN_OPACITY || is_misplaced
}

#[cfg(test)]
mod tests;
