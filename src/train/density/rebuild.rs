//! Carries out a plan of density control on CPU arrays.

use crate::engine::cpu::{rotation, sigmoid};
use crate::engine::density::{DensityPlan, SplitOrigin};
use crate::scene::{Field, Gaussians};

/// The Gaussians after the round that `plan` describes. Moments, statistics and labels are the caller's to rebuild.
pub fn rebuild(old: &Gaussians, plan: &DensityPlan) -> Gaussians {
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

/// Turns Gaussian `i` into one half of itself: moved by half a standard deviation along its longest axis (`side` is 1 or
/// -1), shorter there, and with less opacity, so that both halves together cover what the whole covered.
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
