//! Making a state smaller as decided, moments and statistics with it.

use crate::engine::cpu::softmax;
use crate::light::FULLY_OPEN;
use crate::scene::{Field, Gaussians, IndirectForm, VisibilityForm, sh_count};
use crate::train::complexity::decide::Visibility;
use crate::train::complexity::evidence::Overlap;
use crate::train::density::DensityStats;
use crate::train::state::Learned;

/// Metalness logit of what is held at dielectric: 1e-4.
pub const DIELECTRIC: f32 = -9.0;

/// The same Gaussians with `prototypes` scores (zero) and lower orders: the first coefficients of each.
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

/// Cuts visibility and radiance.
pub fn cut_orders(learned: &mut Learned, visibility: Visibility, radiance: usize) {
    let old = learned.model.gaussians.visibility_order();
    let order = match visibility {
        Visibility::Off => 0,
        Visibility::Order(order) => order.min(old),
    };
    let cut = |g: &Gaussians| reshaped(g, g.prototypes(), order, radiance.min(g.radiance_order()));
    learned.model.gaussians = cut(&learned.model.gaussians);
    learned.moments.first = cut(&learned.moments.first);
    learned.moments.second = cut(&learned.moments.second);
    if visibility == Visibility::Off {
        learned.model.shading.visibility = VisibilityForm::Off;
        learned.model.gaussians.field_mut(Field::Visibility).fill(FULLY_OPEN);
        learned.labels = Vec::new();
    } else {
        let rows = learned.labels.chunks_exact(sh_count(old));
        learned.labels = rows.flat_map(|row| row[..sh_count(order)].iter().copied()).collect();
    }
}

/// Leaves out light that bounces.
pub fn drop_indirect(learned: &mut Learned) {
    learned.model.shading.indirect = IndirectForm::Off;
    learned.gathered = Vec::new();
}

/// Mixed prototype colour of every Gaussian: its albedo without the residual (Eq. 23).
fn mixed(learned: &Learned) -> Vec<[f32; 3]> {
    let (g, colours) = (&learned.model.gaussians, &learned.model.prototypes);
    let mut shares = vec![0.0; g.prototypes()];
    let mix = |i: usize| {
        softmax(g.row(Field::ProtoLogits, i), &mut shares);
        let channel = |c: usize| shares.iter().zip(colours).map(|(p, a)| p * a[c].clamp(0.0, 1.0)).sum();
        std::array::from_fn(channel)
    };
    (0..g.len()).map(mix).collect()
}

/// Moves what the mix of prototypes lost against `wanted` into the residuals: albedos stay what they were.
fn compensate(learned: &mut Learned, wanted: &[[f32; 3]]) {
    let now = mixed(learned);
    for (i, (wanted, now)) in wanted.iter().zip(&now).enumerate() {
        let residual = learned.model.gaussians.row_mut(Field::Residual, i);
        (0..3).for_each(|c| residual[c] += wanted[c] - now[c]);
    }
}

/// Merges prototypes by `groups` (heaviest member first); no albedo changes.
pub fn merge_prototypes(learned: &mut Learned, groups: &[Vec<usize>], overlap: &Overlap) {
    let before = mixed(learned);
    let n = groups.len();
    let merge = |g: &Gaussians, combine: &dyn Fn(&[f32], &[usize]) -> f32| {
        let mut out = reshaped(g, n, g.visibility_order(), g.radiance_order());
        for i in 0..g.len() {
            let row = g.row(Field::ProtoLogits, i);
            let target = out.row_mut(Field::ProtoLogits, i);
            target.iter_mut().zip(groups).for_each(|(t, group)| *t = combine(row, group));
        }
        out
    };
    // Shares add up, so scores go by log-sum-exp; moments are those of the heaviest.
    let log_sum = |row: &[f32], group: &[usize]| {
        let top = group.iter().map(|k| row[*k]).fold(f32::NEG_INFINITY, f32::max);
        top + group.iter().map(|k| (row[*k] - top).exp()).sum::<f32>().ln()
    };
    let heaviest = |row: &[f32], group: &[usize]| row[group[0]];
    learned.model.gaussians = merge(&learned.model.gaussians, &log_sum);
    learned.moments.first = merge(&learned.moments.first, &heaviest);
    learned.moments.second = merge(&learned.moments.second, &heaviest);
    let old = std::mem::take(&mut learned.model.prototypes);
    learned.model.prototypes = groups.iter().map(|group| overlap.mean(&old, group)).collect();
    for moments in &mut learned.moments.globals {
        let rest = moments.split_off(old.len());
        *moments = groups.iter().map(|group| moments[group[0]]).chain(rest).collect();
    }
    // Where nothing was merged nothing needs moving, and nothing is touched.
    if n < old.len() {
        compensate(learned, &before);
    }
}

/// Makes every surface dielectric; what was left of its albedo beside the metal stays: the same diffuse colour.
pub fn make_dielectric(learned: &mut Learned) {
    let metalness = |learned: &Learned, i: usize| {
        crate::engine::cpu::sigmoid(learned.model.gaussians.row(Field::MetalLogit, i)[0])
    };
    let n = learned.model.gaussians.len();
    let mean = (0..n).map(|i| metalness(learned, i)).sum::<f32>() / n.max(1) as f32;
    let mut wanted = mixed(learned);
    for (i, colour) in wanted.iter_mut().enumerate() {
        let left = 1.0 - metalness(learned, i);
        let residual = learned.model.gaussians.row_mut(Field::Residual, i);
        residual.iter_mut().for_each(|r| *r *= left);
        colour.iter_mut().for_each(|v| *v *= left);
    }
    // Most of it is common to all, and that much goes into the prototypes.
    learned.model.prototypes.iter_mut().flatten().for_each(|v| *v = v.clamp(0.0, 1.0) * (1.0 - mean));
    compensate(learned, &wanted);
    hold_dielectric(learned);
}

/// Sets metalness to none, and forgets how it was learned.
pub fn hold_dielectric(learned: &mut Learned) {
    learned.model.gaussians.field_mut(Field::MetalLogit).fill(DIELECTRIC);
    for moments in [&mut learned.moments.first, &mut learned.moments.second] {
        moments.field_mut(Field::MetalLogit).fill(0.0);
    }
}

/// Keeps the Gaussians of `indices` only, with all that was measured of them.
pub fn keep(learned: &mut Learned, indices: &[usize]) {
    let width = learned.labels.len() / learned.model.gaussians.len().max(1);
    learned.model.gaussians = learned.model.gaussians.gathered(indices);
    learned.moments.gather(&indices.iter().map(|i| Some(*i)).collect::<Vec<_>>());
    learned.density = DensityStats {
        pull: indices.iter().map(|i| learned.density.pull[*i]).collect(),
        seen: indices.iter().map(|i| learned.density.seen[*i]).collect(),
    };
    if width > 0 {
        let row = |i: &usize| learned.labels[i * width..(i + 1) * width].iter().copied();
        learned.labels = indices.iter().flat_map(row).collect();
    }
    if !learned.gathered.is_empty() {
        learned.gathered = indices.iter().map(|i| learned.gathered[*i]).collect();
    }
}
