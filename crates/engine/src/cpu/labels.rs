//! Sums over the pixels to which each Gaussian contributes: backward transmittance, the transmittance behind it, as a pseudo label
//! (article Eq. 14-15); and weighted sums of values of pixels.

use multiversion::multiversion;
use rayon::prelude::*;

use crate::cpu::blend::{BlendScratch, TileJob, capped};
use crate::cpu::lanes::{LANES, Lanes};
use crate::cpu::pass::Pass;
use relume_layout::constants::{EarlyStop, TILE};

/// A Gaussian's label: mean backward transmittance over the pixels it contributes to, and their summed weight.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BackwardLabel {
    /// `sum w That / sum w`, or 0 without weight.
    pub transmittance: f32,
    /// `sum w`.
    pub weight: f32,
}

/// Labels per splat. All splats count, independent of the pass's early stop.
pub fn backward_labels(pass: &Pass) -> Vec<BackwardLabel> {
    let label = |[sum, weight]: [f32; 2]| {
        let transmittance = if weight > 0.0 { sum / weight } else { 0.0 };
        BackwardLabel { transmittance, weight }
    };
    sums_by_splat(pass, label_tile).into_iter().map(label).collect()
}

/// `[sum w v, sum w]` per splat over the pixels to which it contributes with weight w, where v is the pixel's value in `values`, row-major.
pub fn weighted_sums(pass: &Pass, values: &[f32]) -> Vec<[f32; 2]> {
    let width = pass.view.width;
    sums_by_splat(pass, |job, columns, rows, scratch, out| {
        let first = job.origin.1 * width + job.origin.0;
        sum_tile(job, (columns, rows), (&values[first..], width), scratch, out);
    })
}

/// Adds `[sum w v, sum w]` over the tile's pixels inside the image, whose values are rows of `width`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
fn sum_tile(
    job: &TileJob<'_>,
    (columns, rows): (usize, usize),
    (values, width): (&[f32], usize),
    scratch: &mut BlendScratch,
    out: &mut [[f32; 2]],
) {
    scratch.gather(job);
    for row in 0..rows {
        scratch.find_entries(job.origin.0, job.origin.1 + row, EarlyStop::Never);
        let of_row = &values[row * width..][..columns];
        for e in &scratch.entries {
            let target = &mut out[e.local as usize];
            for (i, value) in of_row.iter().enumerate() {
                let w = e.transmittance.0[i] * capped(e.alpha.0[i]);
                target[0] += w * value;
                target[1] += w;
            }
        }
    }
}

/// Sums over tiles of the pairs that `of_tile(job, columns, rows, scratch, sums)` adds for each member of a tile.
fn sums_by_splat(
    pass: &Pass,
    of_tile: impl Fn(&TileJob<'_>, usize, usize, &mut BlendScratch, &mut [[f32; 2]]) + Sync,
) -> Vec<[f32; 2]> {
    let per_tile: Vec<Vec<[f32; 2]>> = (0..pass.tiles.len())
        .into_par_iter()
        .map_init(BlendScratch::default, |scratch, tile| {
            let members = pass.tiles.members(tile);
            let job = TileJob {
                splats: &pass.splats,
                members,
                attributes: &pass.attributes,
                stored: pass.channels.stored(),
                origin: pass.tiles.origin(tile),
                early_stop: EarlyStop::Never,
            };
            let mut out = vec![[0.0f32; 2]; members.len()];
            let (x0, y0) = job.origin;
            let columns = pass.view.width.saturating_sub(x0).min(LANES);
            let rows = pass.view.height.saturating_sub(y0).min(TILE);
            of_tile(&job, columns, rows, scratch, &mut out);
            out
        })
        .collect();
    let of_splat = |splat| {
        let mut sums = [0.0f32; 2];
        for &slot in pass.tiles.slots_of_splat(splat) {
            let slot = slot as usize;
            let tile = pass.tiles.first_slot.partition_point(|first| *first as usize <= slot) - 1;
            let local = slot - pass.tiles.first_slot[tile] as usize;
            (0..2).for_each(|k| sums[k] += per_tile[tile][local][k]);
        }
        sums
    };
    (0..pass.splats.len()).map(of_splat).collect()
}

/// Adds `[sum w That, sum w]` over the tile's pixels inside the image.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
fn label_tile(
    job: &TileJob<'_>,
    columns: usize,
    rows: usize,
    scratch: &mut BlendScratch,
    out: &mut [[f32; 2]],
) {
    scratch.gather(job);
    for row in 0..rows {
        scratch.find_entries(job.origin.0, job.origin.1 + row, EarlyStop::Never);
        // From back to front, the running product is That (Eq. 14), without a division.
        let mut behind = Lanes::ONE;
        for e in scratch.entries.iter().rev() {
            let mut sums = [0.0f32; 2];
            for i in 0..columns {
                let alpha = capped(e.alpha.0[i]);
                let w = e.transmittance.0[i] * alpha;
                sums[0] += w * behind.0[i];
                sums[1] += w;
                behind.0[i] *= 1.0 - alpha;
            }
            let target = &mut out[e.local as usize];
            (0..2).for_each(|k| target[k] += sums[k]);
        }
    }
}
