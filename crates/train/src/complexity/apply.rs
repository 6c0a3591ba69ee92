//! Reduces a training state as decided, including its moments and statistics.

use crate::complexity::decide::RequiredVisibility;
use crate::complexity::evidence::Overlap;
use relume_engine::{TrainState, sigmoid, softmax};
use relume_scene::light::UNOCCLUDED_SH0;
use relume_scene::{Field, Gaussians, IndirectForm, VisibilityForm, sh_count};

/// Metalness logit of a dielectric surface: a metalness of 1e-4.
pub const DIELECTRIC: f32 = -9.0;

/// The Gaussians with `prototypes` scores and lower SH degrees, which keep the first coefficients. If the number of
/// prototypes changes, the scores are zero.
fn reshaped(g: &Gaussians, prototypes: usize, visibility: usize, radiance: usize) -> Gaussians {
    let mut out = Gaussians::zeroed(g.len(), prototypes, visibility, radiance);
    for (field, width, data) in out.fields_mut().filter(|(field, ..)| *field != Field::ProtoLogits) {
        for (i, row) in data.chunks_exact_mut(width).enumerate() {
            row.copy_from_slice(&g.row(field, i)[..width]);
        }
    }
    if prototypes == g.prototypes() {
        out.field_mut(Field::ProtoLogits).copy_from_slice(g.field(Field::ProtoLogits));
    }
    out
}

/// Reduces the SH degrees of visibility and radiance, in the moments and labels too.
pub fn cut_degrees(state: &mut TrainState, visibility: RequiredVisibility, radiance: usize) {
    let old = state.model.gaussians.visibility_degree();
    let sh_degree = match visibility {
        RequiredVisibility::Off => 0,
        RequiredVisibility::Degree(sh_degree) => sh_degree.min(old),
    };
    let cut = |g: &Gaussians| reshaped(g, g.prototypes(), sh_degree, radiance.min(g.radiance_degree()));
    state.model.gaussians = cut(&state.model.gaussians);
    state.moments.first = cut(&state.moments.first);
    state.moments.second = cut(&state.moments.second);
    if visibility == RequiredVisibility::Off {
        state.model.shading.visibility = VisibilityForm::Off;
        state.model.gaussians.field_mut(Field::Visibility).fill(UNOCCLUDED_SH0);
        state.labels = Vec::new();
        state.arriving = Vec::new();
    } else {
        let rows = state.labels.chunks_exact(sh_count(old));
        state.labels = rows.flat_map(|row| row[..sh_count(sh_degree)].iter().copied()).collect();
    }
}

/// Removes bounced light.
pub fn drop_indirect(state: &mut TrainState) {
    state.model.shading.indirect = IndirectForm::Off;
    state.gathered = Vec::new();
}

/// Mixed prototype colour of every Gaussian: its albedo without the residual (Eq. 23).
fn mixed(state: &TrainState) -> Vec<[f32; 3]> {
    let (g, colours) = (&state.model.gaussians, &state.model.prototypes);
    let mut shares = vec![0.0; g.prototypes()];
    let mix = |i: usize| {
        softmax(g.row(Field::ProtoLogits, i), &mut shares);
        let channel = |c: usize| shares.iter().zip(colours).map(|(p, a)| p * a[c].clamp(0.0, 1.0)).sum();
        std::array::from_fn(channel)
    };
    (0..g.len()).map(mix).collect()
}

/// Adds the difference between `wanted` and the mixed prototypes to the residuals.
fn compensate(state: &mut TrainState, wanted: &[[f32; 3]]) {
    let now = mixed(state);
    for (i, (wanted, now)) in wanted.iter().zip(&now).enumerate() {
        let residual = state.model.gaussians.row_mut(Field::Residual, i);
        (0..3).for_each(|c| residual[c] += wanted[c] - now[c]);
    }
}

/// Merges prototypes by `groups` (heaviest member first). Every albedo stays the same.
pub fn merge_prototypes(state: &mut TrainState, groups: &[Vec<usize>], overlap: &Overlap) {
    let before = mixed(state);
    let n = groups.len();
    let merge = |g: &Gaussians, combine: &dyn Fn(&[f32], &[usize]) -> f32| {
        let mut out = reshaped(g, n, g.visibility_degree(), g.radiance_degree());
        for i in 0..g.len() {
            let row = g.row(Field::ProtoLogits, i);
            let target = out.row_mut(Field::ProtoLogits, i);
            target.iter_mut().zip(groups).for_each(|(t, group)| *t = combine(row, group));
        }
        out
    };
    // Shares add up, so scores combine by log-sum-exp. Moments are those of the heaviest member.
    let log_sum = |row: &[f32], group: &[usize]| {
        let top = group.iter().map(|k| row[*k]).fold(f32::NEG_INFINITY, f32::max);
        top + group.iter().map(|k| (row[*k] - top).exp()).sum::<f32>().ln()
    };
    let heaviest = |row: &[f32], group: &[usize]| row[group[0]];
    state.model.gaussians = merge(&state.model.gaussians, &log_sum);
    state.moments.first = merge(&state.moments.first, &heaviest);
    state.moments.second = merge(&state.moments.second, &heaviest);
    let old = std::mem::take(&mut state.model.prototypes);
    state.model.prototypes = groups.iter().map(|group| overlap.mean(&old, group)).collect();
    for moments in &mut state.moments.globals {
        let rest = moments.split_off(old.len());
        *moments = groups.iter().map(|group| moments[group[0]]).chain(rest).collect();
    }
    // Without a merge the residuals stay bit-identical.
    if n < old.len() {
        compensate(state, &before);
    }
}

/// Makes every surface dielectric and keeps its diffuse colour: the new albedo is albedo times one minus metalness.
pub fn make_dielectric(state: &mut TrainState) {
    let metalness =
        |state: &TrainState, i: usize| sigmoid(state.model.gaussians.row(Field::MetalLogit, i)[0]);
    let n = state.model.gaussians.len();
    let mean = (0..n).map(|i| metalness(state, i)).sum::<f32>() / n.max(1) as f32;
    let mut wanted = mixed(state);
    for (i, colour) in wanted.iter_mut().enumerate() {
        let left = 1.0 - metalness(state, i);
        let residual = state.model.gaussians.row_mut(Field::Residual, i);
        residual.iter_mut().for_each(|r| *r *= left);
        colour.iter_mut().for_each(|v| *v *= left);
    }
    // The mean of that factor is applied to the prototypes, the rest to the residuals.
    state.model.prototypes.iter_mut().flatten().for_each(|v| *v = v.clamp(0.0, 1.0) * (1.0 - mean));
    compensate(state, &wanted);
    hold_dielectric(state);
}

/// Sets metalness to that of a dielectric and its moments to zero.
pub fn hold_dielectric(state: &mut TrainState) {
    state.model.gaussians.field_mut(Field::MetalLogit).fill(DIELECTRIC);
    for moments in [&mut state.moments.first, &mut state.moments.second] {
        moments.field_mut(Field::MetalLogit).fill(0.0);
    }
}
