//! Density control: where Gaussians are added and dropped, up to a budget.
//!
//! The signal is that of AbsGS (what pulls at the projected mean, pixel by pixel), the budget is filled best first. Every
//! Gaussian that is chosen splits in two along its longest axis, so there is one rule, no random draw, and the picture
//! hardly moves.

use crate::engine::Gradients;
use crate::engine::constants::{HALF_OPACITY_EXPONENT, HALF_SCALE_ACROSS, HALF_SCALE_ALONG};
use crate::engine::cpu::{rotation, sigmoid};
use crate::scene::{Field, Gaussians, Model};
use crate::train::optimiser::Moments;

/// Mean pull (half image widths) above which a Gaussian is worth splitting.
const SPLIT_PULL: f32 = 4e-4;
/// Gaussians fainter than this are dropped.
const LEAST_OPACITY: f32 = 0.008;
/// Gaussians longer than this share of the scene radius are dropped.
const MOST_SCALE: f32 = 0.5;
/// Without masks, Gaussians nearer than this to a camera are dropped, scene radii.
const CAMERA_CLEARANCE: f32 = 0.2;
/// Most growth of one round.
const MOST_GROWTH: f32 = 0.25;

/// Running statistics since the last round.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DensityStats {
    /// Sum of pulls ([`Gradients::absgrad`]).
    pub pull: Vec<f32>,
    /// Steps in which the Gaussian was on screen.
    pub seen: Vec<f32>,
}

impl DensityStats {
    /// Empty statistics for `n` Gaussians.
    pub fn zeroed(n: usize) -> Self {
        Self { pull: vec![0.0; n], seen: vec![0.0; n] }
    }

    /// Takes a step's gradients in.
    pub fn record(&mut self, g: &Gradients) {
        for (i, visible) in g.visible.iter().enumerate() {
            if *visible {
                self.pull[i] += g.absgrad[i];
                self.seen[i] += 1.0;
            }
        }
    }
}

/// A round of density control: where each Gaussian of the next generation comes from.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Plan {
    /// Index in the old generation.
    pub source: Vec<u32>,
    /// 0: unchanged. 1 or -1: that half of its source, with fresh moments.
    pub side: Vec<f32>,
}

/// What the choice is made from, a row a Gaussian.
#[derive(Debug, Clone, Copy)]
pub struct Candidates<'a> {
    /// Centres (3).
    pub means: &'a [f32],
    /// ln of the standard deviations (3).
    pub log_scales: &'a [f32],
    /// Opacity logits (1).
    pub opacity_logits: &'a [f32],
}

impl<'a> From<&'a Gaussians> for Candidates<'a> {
    fn from(g: &'a Gaussians) -> Self {
        Self {
            means: g.field(Field::Mean),
            log_scales: g.field(Field::LogScale),
            opacity_logits: g.field(Field::OpacityLogit),
        }
    }
}

/// Drops what is faint or huge, splits what matters most while the budget lasts.
///
/// `eyes`: camera centres of a scene without masks. Such a scene keeps its big background Gaussians, and loses those that
/// hang right in front of a camera, where no other view can correct them.
pub fn plan(of: Candidates<'_>, stats: &DensityStats, budget: usize, eyes: Option<&[[f32; 3]]>) -> Plan {
    let n = of.opacity_logits.len();
    let keep: Vec<usize> = (0..n).filter(|&i| !is_waste(&of, i, eyes)).collect();
    let room = budget.saturating_sub(keep.len()).min((keep.len() as f32 * MOST_GROWTH) as usize + 8);
    let mut wanted: Vec<(f32, usize)> = keep
        .iter()
        .map(|&i| (stats.pull[i] / stats.seen[i].max(1.0), i))
        .filter(|(pull, _)| *pull > SPLIT_PULL)
        .collect();
    wanted.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    wanted.truncate(room);
    let mut chosen = vec![false; n];
    wanted.iter().for_each(|&(_, i)| chosen[i] = true);
    // Survivors in order, then the second halves in order.
    let mut out = Plan::default();
    for &i in &keep {
        out.source.push(i as u32);
        out.side.push(if chosen[i] { 1.0 } else { 0.0 });
    }
    for &i in keep.iter().filter(|&&i| chosen[i]) {
        out.source.push(i as u32);
        out.side.push(-1.0);
    }
    out
}

/// One round on the host: plans, rebuilds the model and its moments, resets the statistics.
pub fn refine(
    model: &mut Model,
    moments: &mut Moments,
    stats: &mut DensityStats,
    budget: usize,
    eyes: Option<&[[f32; 3]]>,
) {
    let g = &model.gaussians;
    let plan = plan(g.into(), stats, budget, eyes);
    let indices: Vec<usize> = plan.source.iter().map(|i| *i as usize).collect();
    let mut next = g.gathered(&indices);
    for (new, side) in plan.side.iter().enumerate().filter(|(_, side)| **side != 0.0) {
        halve(&mut next, new, *side);
    }
    let kept = |(old, side): (&usize, &f32)| (*side == 0.0).then_some(*old);
    let sources: Vec<Option<usize>> = indices.iter().zip(&plan.side).map(kept).collect();
    moments.gather(&sources);
    *stats = DensityStats::zeroed(next.len());
    model.gaussians = next;
}

fn is_waste(of: &Candidates<'_>, i: usize, eyes: Option<&[[f32; 3]]>) -> bool {
    let row = |values: &[f32]| [values[3 * i], values[3 * i + 1], values[3 * i + 2]];
    let largest = row(of.log_scales).into_iter().fold(f32::NEG_INFINITY, f32::max);
    let misplaced = match eyes {
        None => largest > MOST_SCALE.ln(),
        Some(eyes) => {
            let mean = row(of.means);
            let near = |eye: &[f32; 3]| {
                (0..3).map(|k| (mean[k] - eye[k]).powi(2)).sum::<f32>() < CAMERA_CLEARANCE.powi(2)
            };
            eyes.iter().any(near)
        }
    };
    sigmoid(of.opacity_logits[i]) < LEAST_OPACITY || misplaced
}

/// Turns Gaussian `i` into one half of itself: moved half a sigma along its longest axis, shorter there, and less
/// opaque so that both halves together hide what the whole did.
fn halve(g: &mut Gaussians, i: usize, side: f32) {
    let scale: [f32; 3] = g.get(Field::LogScale, i);
    let axis = if scale[0] >= scale[1] && scale[0] >= scale[2] {
        0
    } else if scale[1] >= scale[2] {
        1
    } else {
        2
    };
    let q = rotation(g.get(Field::Quaternion, i));
    let step = side * 0.5 * scale[axis].exp();
    for (r, m) in g.row_mut(Field::Mean, i).iter_mut().enumerate() {
        *m += step * q[r][axis];
    }
    for (k, s) in g.row_mut(Field::LogScale, i).iter_mut().enumerate() {
        *s += if k == axis { HALF_SCALE_ALONG.ln() } else { HALF_SCALE_ACROSS.ln() };
    }
    let opacity = &mut g.row_mut(Field::OpacityLogit, i)[0];
    let o = sigmoid(*opacity);
    let halved = (1.0 - (1.0 - o).powf(HALF_OPACITY_EXPONENT)).clamp(0.01, 0.98);
    *opacity = (halved / (1.0 - halved)).ln();
}
