//! Density control on CPU arrays: the signals from which a round is planned, and the rebuilding of the model by the plan.

use crate::cpu::rotation;
use crate::{DensityPlan, DensitySignals, DensityStats, PlannedGaussian, SplitOrigin, TrainState, sigmoid};
use relume_layout::constants::{HALF_OPACITY_EXPONENT, HALF_SCALE_ACROSS, HALF_SCALE_ALONG};
use relume_scene::{Field, Gaussians};

/// The signals from which a round is planned.
pub fn signals(state: &TrainState) -> DensitySignals {
    let g = &state.model.gaussians;
    let rows = |field: Field| g.field(field).as_chunks::<3>().0.to_vec();
    DensitySignals {
        means: rows(Field::Mean),
        log_scales: rows(Field::LogScale),
        opacity_logits: g.field(Field::OpacityLogit).to_vec(),
        stats: state.density.clone(),
    }
}

/// Rebuilds the model, its moments and its measurements by `plan`, and clears the statistics. Each new Gaussian has the measurements of its
/// source.
pub fn rebuild(state: &mut TrainState, plan: &DensityPlan) {
    let before = state.model.gaussians.len();
    let coefficients = state.labels.len() / before.max(1);
    state.labels = inherited(&state.labels, before, coefficients, plan);
    state.gathered = inherited(&state.gathered, before, 1, plan);
    state.arriving = inherited(&state.arriving, before, 1, plan);
    let kept = |g: &PlannedGaussian| (g.origin == SplitOrigin::Keep).then_some(g.source as usize);
    state.moments.gather(&plan.gaussians.iter().map(kept).collect::<Vec<_>>());
    state.density = DensityStats::zeroed(plan.gaussians.len());
    state.model.gaussians = rebuilt(&state.model.gaussians, plan);
}

/// The rows of `width` values of the sources of `plan`, in each block of rows of `before` Gaussians.
fn inherited<T: Copy>(old: &[T], before: usize, width: usize, plan: &DensityPlan) -> Vec<T> {
    let mut new = Vec::with_capacity(old.len() / before.max(1) * plan.gaussians.len());
    for block in old.chunks_exact((before * width).max(1)) {
        for planned in &plan.gaussians {
            new.extend_from_slice(&block[planned.source as usize * width..][..width]);
        }
    }
    new
}

fn rebuilt(old: &Gaussians, plan: &DensityPlan) -> Gaussians {
    let sources: Vec<usize> = plan.gaussians.iter().map(|g| g.source as usize).collect();
    let mut new = old.gathered(&sources);
    for (i, planned) in plan.gaussians.iter().enumerate() {
        match planned.origin {
            SplitOrigin::Keep => {}
            SplitOrigin::UpperHalf => halve(&mut new, i, 1.0),
            SplitOrigin::LowerHalf => halve(&mut new, i, -1.0),
        }
    }
    new
}

/// Turns Gaussian `i` into one half of itself: moves it by half a standard deviation along its longest axis
/// (`side` is 1 or -1), reduces the standard deviations, most along that axis, and the opacity, so that both
/// halves together cover what the whole covered.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn new_gaussians_have_the_measurements_of_their_sources() {
        let planned = |source| PlannedGaussian { source, origin: SplitOrigin::LowerHalf };
        let plan = DensityPlan { gaussians: [2, 0, 2].map(planned).to_vec() };
        let rows: Vec<u32> = (0..12).collect();
        assert_eq!(inherited(&rows[..6], 3, 2, &plan), [4, 5, 0, 1, 4, 5]);
        let two_lights = inherited(&rows[..6], 3, 1, &plan);
        assert_eq!(two_lights, [2, 0, 2, 5, 3, 5], "a block for each light");
        assert!(inherited::<u32>(&[], 3, 0, &plan).is_empty(), "nothing was measured");
        assert!(inherited::<u32>(&[], 0, 0, &DensityPlan::default()).is_empty());
    }
}
