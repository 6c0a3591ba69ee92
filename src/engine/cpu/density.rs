//! Density control on the CPU engine: its statistics, and the rebuilding of the model as planned.

use crate::engine::cpu::{rotation, sigmoid};
use crate::engine::density::{DensityPlan, DensitySignals, DensityStats, Positions, SplitOrigin};
use crate::engine::{Gradients, TrainState};
use crate::scene::{Field, Gaussians};

/// Takes a step's gradients in.
pub(super) fn record(stats: &mut DensityStats, gradients: &Gradients) {
    for (i, _) in gradients.visible.iter().enumerate().filter(|(_, visible)| **visible) {
        stats.absgrad[i] += gradients.pull[i];
        stats.seen[i] += 1.0;
    }
}

/// What a round is planned from.
pub(super) fn signals(state: &TrainState, positions: Positions) -> DensitySignals {
    let g = &state.model.gaussians;
    let rows = |field: Field| g.field(field).as_chunks::<3>().0.to_vec();
    DensitySignals {
        means: if positions == Positions::Read { rows(Field::Mean) } else { Vec::new() },
        log_scales: rows(Field::LogScale),
        opacity_logits: g.field(Field::OpacityLogit).to_vec(),
        stats: state.density.clone(),
    }
}

/// Rebuilds the model and its moments, and clears the statistics.
pub(super) fn rebuild(state: &mut TrainState, plan: &DensityPlan) {
    let indices: Vec<usize> = plan.entries.iter().map(|(source, _)| *source as usize).collect();
    let mut next = state.model.gaussians.gathered(&indices);
    for (i, (_, origin)) in plan.entries.iter().enumerate() {
        match origin {
            SplitOrigin::Keep => {}
            SplitOrigin::UpperHalf => halve(&mut next, i, 1.0),
            SplitOrigin::LowerHalf => halve(&mut next, i, -1.0),
        }
    }
    let kept = |(source, origin): &(u32, SplitOrigin)| (*origin == SplitOrigin::Keep).then_some(*source as usize);
    let sources: Vec<Option<usize>> = plan.entries.iter().map(kept).collect();
    state.moments.gather(&sources);
    state.density = DensityStats::zeroed(next.len());
    state.model.gaussians = next;
}

/// Turns Gaussian `i` into one half of itself: moved half a sigma along its longest axis (towards `side`), shorter there,
/// and less opaque so that both halves together hide what the whole did.
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
