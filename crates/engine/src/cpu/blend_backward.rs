//! Backward pass of the blending in one tile.
//!
//! The pass recomputes the weights (which is cheaper than storing them), splat by splat over the tile's rows, which are
//! independent. A sweep from the last splat to the first then turns `s = A G^T`, one scalar per splat and pixel, into the
//! gradient of alpha. All sums of a splat over its pixels are accumulated in one visit, as whole vectors over the rows, and
//! reduced once. A column's offset from the mean is the same in every row, so three moments (1, dy, dy^2) of the alpha
//! gradient suffice to recover all six. The tile's gradient (1 KB per row at 16 channels) stays in the L1 cache.
//! The loops process four channels at a time, with rows innermost: with channels innermost the compiler vectorises across
//! channels, by gathers and scatters.

use multiversion::multiversion;

use crate::cpu::blend::{BlendScratch, LocalSplat, TileJob, behind_splat, capped, is_finished};
use crate::cpu::lanes::{LANES, Lanes, totals};
use relume_layout::constants::{ALPHA_MAX, TILE};

/// Leading floats of a gradient row: projected mean (2), conic (3), opacity (1), absgrad (1), then the channels.
///
/// Absgrad is the sum over pixels of the *length* of each pixel's gradient by the projected mean (AbsGS, Ye et al. 2024, sums
/// absolute values per axis). Gradients of opposite sign cancel in the mean's gradient but not in absgrad.
pub const ROW_HEADER: usize = 7;
/// Index of absgrad in a gradient row.
pub const ABSGRAD: usize = ROW_HEADER - 1;

/// Channels processed together.
const BLOCK: usize = 4;

/// Buffers that a thread reuses for each tile.
#[derive(Debug, Default)]
pub struct BackwardScratch {
    blend: BlendScratch,
    /// The rows that each splat reaches, splat by splat.
    entries: Vec<RowEntry>,
    /// First entry of each splat, and the end.
    first_entry: Vec<usize>,
    /// The tile's gradient, `[row][block]`, in whole blocks.
    gradient: Vec<[Lanes; BLOCK]>,
}

/// One splat in one row of the tile.
#[derive(Debug, Clone, Copy)]
struct RowEntry {
    row: usize,
    /// Alpha before the cap, 0 where below 1/255.
    alpha: Lanes,
    /// Transmittance in front of the splat.
    transmittance: Lanes,
}

/// Front-to-back state of a tile's rows.
struct Rows {
    transmittance: [Lanes; TILE],
    /// Number of splats that reached the row.
    count: [u32; TILE],
    /// True when later splats do not count: the row is saturated or has no gradient.
    is_done: [bool; TILE],
}

/// Gradient rows of the tile's splats into `out` (`members.len()` rows of `ROW_HEADER + channels` floats).
///
/// `gradient` is `[row][channel][lane]` with `gradient_stored` channels a row, of which the first `channels` count;
/// pixels outside the image must be zero in it.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
pub fn blend_tile_backward(
    job: &TileJob<'_>,
    gradient: &[f32],
    gradient_stored: usize,
    channels: usize,
    scratch: &mut BackwardScratch,
    out: &mut [f32],
) {
    scratch.blend.gather(job);
    let blocks = channels.div_ceil(BLOCK);
    let is_done = load_gradient(gradient, gradient_stored, channels, scratch);
    find_entries(job, is_done, scratch);
    // Sum of w_j s_j over the splats behind, per row.
    let mut behind = [Lanes::ZERO; TILE];
    for (local, target) in out.chunks_exact_mut(ROW_HEADER + channels).enumerate().rev() {
        let entries = scratch.first_entry[local]..scratch.first_entry[local + 1];
        let Some(entries) = scratch.entries.get(entries).filter(|e| !e.is_empty()) else { continue };
        let attributes = &job.attributes[job.members[local] as usize * job.stored..];
        let mut flow = [Lanes::ZERO; TILE];
        project_gradient(entries, attributes, &scratch.gradient, blocks, &mut flow);
        let mut weights = [Lanes::ZERO; TILE];
        alpha_flow(entries, &mut behind, &mut flow, &mut weights);
        let splat = &scratch.blend.splats[local];
        target[..ROW_HEADER].copy_from_slice(&header(splat, job.origin, entries, &flow));
        collect(entries, &scratch.gradient, blocks, &weights, &mut target[ROW_HEADER..]);
    }
}

/// Fills the scratch's gradient; returns which rows have none.
#[inline(always)]
fn load_gradient(
    gradient: &[f32],
    stored: usize,
    channels: usize,
    scratch: &mut BackwardScratch,
) -> [bool; TILE] {
    let blocks = channels.div_ceil(BLOCK);
    scratch.gradient.clear();
    scratch.gradient.resize(TILE * blocks, [Lanes::ZERO; BLOCK]);
    let mut is_empty = [true; TILE];
    let rows = scratch.gradient.chunks_exact_mut(blocks).zip(gradient.chunks_exact(stored * LANES));
    for ((target, source), is_empty) in rows.zip(&mut is_empty) {
        for (g, source) in target.as_flattened_mut().iter_mut().zip(source.chunks_exact(LANES)).take(channels)
        {
            *g = Lanes::load(source);
            *is_empty &= *g == Lanes::ZERO;
        }
    }
    is_empty
}

/// Fills the scratch's entries, as in the forward pass ([`BlendScratch::find_entries`]).
#[inline(always)]
fn find_entries(job: &TileJob<'_>, is_done: [bool; TILE], scratch: &mut BackwardScratch) {
    let mut rows = Rows { transmittance: [Lanes::ONE; TILE], count: [0; TILE], is_done };
    scratch.entries.clear();
    scratch.first_entry.clear();
    for splat in &scratch.blend.splats {
        scratch.first_entry.push(scratch.entries.len());
        for row in 0..TILE {
            if rows.is_done[row] {
                continue;
            }
            let Some(alpha) = splat.alpha(job.origin.0, job.origin.1 + row) else { continue };
            let transmittance = rows.transmittance[row];
            scratch.entries.push(RowEntry { row, alpha, transmittance });
            rows.transmittance[row] = behind_splat(&transmittance, &alpha);
            rows.count[row] += 1;
            rows.is_done[row] =
                is_finished(job.early_stop, rows.count[row] as usize, &rows.transmittance[row]);
        }
    }
    scratch.first_entry.push(scratch.entries.len());
}

/// Sets `flow` to `s`, entry by entry: the gradient of the row times the splat's attributes.
#[inline(always)]
fn project_gradient(
    entries: &[RowEntry],
    attributes: &[f32],
    gradient: &[[Lanes; BLOCK]],
    blocks: usize,
    flow: &mut [Lanes; TILE],
) {
    for (block, a) in attributes.as_chunks::<BLOCK>().0[..blocks].iter().enumerate() {
        for (e, flow) in entries.iter().zip(flow.iter_mut()) {
            let g = &gradient[e.row * blocks + block];
            let mut s = *flow;
            s.add_product(a[0], &g[0]);
            s.add_product(a[1], &g[1]);
            s.add_product(a[2], &g[2]);
            s.add_product(a[3], &g[3]);
            *flow = s;
        }
    }
}

/// Turns `flow` from `s` into `dL/d alpha * alpha` (zero where alpha is capped or cut), and fills `weights`.
#[inline(always)]
fn alpha_flow(
    entries: &[RowEntry],
    behind: &mut [Lanes; TILE],
    flow: &mut [Lanes; TILE],
    weights: &mut [Lanes; TILE],
) {
    for ((e, flow), weight) in entries.iter().zip(flow).zip(weights) {
        let (s, t, mut sum) = (*flow, e.transmittance, behind[e.row]);
        let alpha = Lanes::from_fn(|i| capped(e.alpha.0[i]));
        let by_alpha = Lanes::from_fn(|i| t.0[i] * s.0[i] - sum.0[i] / (1.0 - alpha.0[i]));
        let w = Lanes::from_fn(|i| t.0[i] * alpha.0[i]);
        sum.add_products(&w, &s);
        let flowing = Lanes::from_fn(|i| by_alpha.0[i] * alpha.0[i]);
        *flow = Lanes::from_fn(|i| if e.alpha.0[i] < ALPHA_MAX { flowing.0[i] } else { 0.0 });
        (*weight, behind[e.row]) = (w, sum);
    }
}

/// The leading floats of a splat's gradient row.
#[inline(always)]
fn header(
    splat: &LocalSplat,
    (x, y): (usize, usize),
    entries: &[RowEntry],
    flow: &[Lanes; TILE],
) -> [f32; ROW_HEADER] {
    let (x0, [a, b, c]) = (splat.dx(x), splat.conic());
    let dx = Lanes::from_fn(|i| x0 + i as f32);
    // Moments 1, dy and dy^2 of the alpha gradient, and absgrad.
    let mut sums = [Lanes::ZERO; 4];
    for (e, flow) in entries.iter().zip(flow) {
        let dy = splat.dy(y + e.row);
        let (gx, gy) = (Lanes::from_fn(|i| a * dx.0[i] + b * dy), Lanes::from_fn(|i| b * dx.0[i] + c * dy));
        let square = Lanes::from_fn(|i| gx.0[i] * gx.0[i] + gy.0[i] * gy.0[i]);
        let absgrad = Lanes::from_fn(|i| square.0[i].sqrt() * flow.0[i].abs());
        sums[0].add_product(1.0, flow);
        sums[1].add_product(dy, flow);
        sums[2].add_product(dy * dy, flow);
        sums[3].add_product(1.0, &absgrad);
    }
    let x = Lanes::from_fn(|i| sums[0].0[i] * dx.0[i]);
    let xx = Lanes::from_fn(|i| x.0[i] * dx.0[i]);
    let xy = Lanes::from_fn(|i| sums[1].0[i] * dx.0[i]);
    let [one, y, yy, absgrad] = totals(&sums);
    let [x, xx, xy, _] = totals(&[x, xx, xy, Lanes::ZERO]);
    [a * x + b * y, b * x + c * y, -0.5 * xx, -xy, -0.5 * yy, one / splat.opacity(), absgrad]
}

/// The rows' gradients times the splat's weights, summed over the tile, into `out`.
#[inline(always)]
fn collect(
    entries: &[RowEntry],
    gradient: &[[Lanes; BLOCK]],
    blocks: usize,
    weights: &[Lanes; TILE],
    out: &mut [f32],
) {
    for (block, out) in out.chunks_mut(BLOCK).enumerate() {
        let mut sums = [Lanes::ZERO; BLOCK];
        for (e, weight) in entries.iter().zip(weights) {
            let g = &gradient[e.row * blocks + block];
            sums[0].add_products(weight, &g[0]);
            sums[1].add_products(weight, &g[1]);
            sums[2].add_products(weight, &g[2]);
            sums[3].add_products(weight, &g[3]);
        }
        let totals = totals(&sums);
        out.copy_from_slice(&totals[..out.len()]);
    }
}
