//! Density control: where Gaussians are added and dropped, up to a budget.
//!
//! Signal and thresholds follow 3DGS (mean screen-space gradient), the budget is filled best first. Every Gaussian that
//! is chosen splits in two along its longest axis, so there is one rule, no random draw, and the picture hardly moves.

use crate::engine::Gradients;
use crate::engine::cpu::{rotation, sigmoid};
use crate::scene::{Field, Gaussians, Model};
use crate::train::optimiser::Moments;

/// Mean screen gradient (half image widths) above which a Gaussian is worth splitting.
const SPLIT_GRADIENT: f32 = 1.5e-4;
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
    /// Sum of screen gradients.
    pub gradient: Vec<f32>,
    /// Steps in which the Gaussian was on screen.
    pub seen: Vec<f32>,
}

impl DensityStats {
    /// Empty statistics for `n` Gaussians.
    pub fn zeroed(n: usize) -> Self {
        Self { gradient: vec![0.0; n], seen: vec![0.0; n] }
    }

    /// Takes a step's gradients in.
    pub fn record(&mut self, g: &Gradients) {
        for (i, visible) in g.visible.iter().enumerate() {
            if *visible {
                self.gradient[i] += g.screen[i];
                self.seen[i] += 1.0;
            }
        }
    }
}

/// One round: drops what is faint or huge, splits what matters most, resets the statistics.
///
/// `eyes`: camera centres of a scene without masks. Such a scene keeps its big background Gaussians, and loses those that
/// hang right in front of a camera, where no other view can correct them.
pub fn refine(
    model: &mut Model,
    moments: &mut Moments,
    stats: &mut DensityStats,
    budget: usize,
    eyes: Option<&[[f32; 3]]>,
) {
    let g = &model.gaussians;
    let keep: Vec<usize> = (0..g.len()).filter(|&i| !is_waste(g, i, eyes)).collect();
    let room = budget.saturating_sub(keep.len()).min((keep.len() as f32 * MOST_GROWTH) as usize + 8);
    let mut wanted: Vec<(f32, usize)> = keep
        .iter()
        .map(|&i| (stats.gradient[i] / stats.seen[i].max(1.0), i))
        .filter(|(gradient, _)| *gradient > SPLIT_GRADIENT)
        .collect();
    wanted.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    wanted.truncate(room);
    let mut chosen = vec![false; g.len()];
    wanted.iter().for_each(|&(_, i)| chosen[i] = true);
    // Survivors in order, then the second halves in order.
    let second: Vec<usize> = keep.iter().copied().filter(|&i| chosen[i]).collect();
    let indices: Vec<usize> = keep.iter().chain(&second).copied().collect();
    let mut next = g.gathered(&indices);
    for (new, old) in indices.iter().enumerate() {
        if chosen[*old] {
            let side = if new < keep.len() { 1.0 } else { -1.0 };
            halve(&mut next, new, side);
        }
    }
    let fresh =
        |(new, old): (usize, &usize)| if new < keep.len() && !chosen[*old] { Some(*old) } else { None };
    let sources: Vec<Option<usize>> = indices.iter().enumerate().map(fresh).collect();
    moments.gather(&sources);
    *stats = DensityStats::zeroed(next.len());
    model.gaussians = next;
}

fn is_waste(g: &Gaussians, i: usize, eyes: Option<&[[f32; 3]]>) -> bool {
    let largest = g.row(Field::LogScale, i).iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let misplaced = match eyes {
        None => largest > MOST_SCALE.ln(),
        Some(eyes) => {
            let mean: [f32; 3] = g.get(Field::Mean, i);
            let near = |eye: &[f32; 3]| {
                (0..3).map(|k| (mean[k] - eye[k]).powi(2)).sum::<f32>() < CAMERA_CLEARANCE.powi(2)
            };
            eyes.iter().any(near)
        }
    };
    sigmoid(g.row(Field::OpacityLogit, i)[0]) < LEAST_OPACITY || misplaced
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
        *s += if k == axis { 0.55f32.ln() } else { 0.9f32.ln() };
    }
    let opacity = &mut g.row_mut(Field::OpacityLogit, i)[0];
    let o = sigmoid(*opacity);
    let halved = (1.0 - (1.0 - o).powf(0.7)).clamp(0.01, 0.98);
    *opacity = (halved / (1.0 - halved)).ln();
}
