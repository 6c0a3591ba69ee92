//! Backward pass of the blending in one tile.
//!
//! Per strip: the weights are found again (cheaper than keeping them), `s = A G^T` gives one scalar a splat and pixel,
//! and a back-to-front sweep turns it into the gradient of alpha. Per splat of the tile, sums over pixels are kept as
//! whole vectors over the tile's rows and reduced once at the end; a column's offset from the mean is the same in every
//! row, so three moments (1, dy, dy^2) of the alpha gradient are enough to recover all six.
//! Channels go four at a time, splats in the inner loop: with channels innermost the compiler vectorises across *them*, by
//! gathers and scatters.
//! Tried and lost: horizontal sums per strip (about 12 instructions for each of 16 sums a strip).

use multiversion::multiversion;

use crate::engine::cpu::blend::{BlendScratch, TileJob, capped};
use crate::engine::cpu::lanes::{LANES, Lanes};
use crate::engine::cpu::project::ALPHA_MAX;
use crate::engine::cpu::tiles::TILE;

/// Leading floats of a gradient row: projected mean (2), conic (3), opacity (1), pull (1), then the channels.
///
/// The pull is the sum over pixels of the *length* of each one's gradient by the projected mean: where pixels pull a splat
/// apart the gradient is nothing and the pull is not (AbsGS, Ye et al. 2024, takes absolute values by axis).
pub const ROW_HEADER: usize = 7;

/// Vectors kept per splat in front of the channels: alpha-gradient moments 1, dy, dy^2, and the pull.
const MOMENTS: usize = 4;
/// Channels that are worked on together.
const BLOCK: usize = 4;

/// Memory a thread reuses from tile to tile.
#[derive(Debug, Default)]
pub struct BackwardScratch {
    blend: BlendScratch,
    /// `[splat][moments + channels]`.
    sums: Vec<Lanes>,
    /// `s` per entry, then the alpha gradient times alpha.
    flow: Vec<Lanes>,
    /// Blending weight per entry.
    weights: Vec<Lanes>,
    /// The strip's gradient by channel, in whole blocks.
    gradient: Vec<[Lanes; BLOCK]>,
}

/// Gradient rows of the tile's splats into `out` (`ranks.len()` rows of `ROW_HEADER + channels` floats).
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
    let width = MOMENTS + BLOCK * blocks;
    scratch.sums.clear();
    scratch.sums.resize(job.ranks.len() * width, Lanes::ZERO);
    for row in 0..TILE {
        let strip = &gradient[row * gradient_stored * LANES..];
        scratch.gradient.clear();
        scratch.gradient.resize(blocks, [Lanes::ZERO; BLOCK]);
        for (g, source) in
            scratch.gradient.as_flattened_mut().iter_mut().zip(strip.chunks_exact(LANES)).take(channels)
        {
            *g = Lanes::load(source);
        }
        if scratch.gradient.as_flattened().iter().all(|g| *g == Lanes::ZERO) {
            continue;
        }
        scratch.blend.find_entries(job.origin.0, job.origin.1 + row, job.early_stop);
        alpha_flow(job, scratch);
        collect((job.origin.0, job.origin.1 + row), width, scratch);
    }
    for (local, target) in out.chunks_exact_mut(ROW_HEADER + channels).enumerate() {
        let sums = &scratch.sums[local * width..(local + 1) * width];
        let splat = &scratch.blend.splats[local];
        let x0 = splat.dx(job.origin.0);
        let (mut one, mut x, mut xx, mut xy) = (Lanes::ZERO, Lanes::ZERO, Lanes::ZERO, Lanes::ZERO);
        for i in 0..LANES {
            let dx = x0 + i as f32;
            one.0[i] = sums[0].0[i];
            x.0[i] = sums[0].0[i] * dx;
            xx.0[i] = x.0[i] * dx;
            xy.0[i] = sums[1].0[i] * dx;
        }
        let (one, x, xx, xy) = (one.sum(), x.sum(), xx.sum(), xy.sum());
        let (y, yy) = (sums[1].sum(), sums[2].sum());
        let [a, b, c] = splat.conic();
        let (mean, pull) = ([a * x + b * y, b * x + c * y], sums[3].sum());
        let header = [mean[0], mean[1], -0.5 * xx, -xy, -0.5 * yy, one / splat.opacity(), pull];
        target[..ROW_HEADER].copy_from_slice(&header);
        for (t, s) in target[ROW_HEADER..].iter_mut().zip(&sums[MOMENTS..]) {
            *t = s.sum();
        }
    }
}

/// Fills `flow` with `dL/d alpha * alpha` of each entry (zero where alpha is capped or cut), and `weights`.
#[inline(always)]
fn alpha_flow(job: &TileJob<'_>, scratch: &mut BackwardScratch) {
    let BackwardScratch { blend, flow, weights, gradient, .. } = scratch;
    let entries = &blend.entries;
    flow.clear();
    flow.resize(entries.len(), Lanes::ZERO);
    for (block, g) in gradient.iter().enumerate() {
        for (e, flow) in entries.iter().zip(flow.iter_mut()) {
            let rank = job.ranks[e.local as usize] as usize;
            let row = &job.attributes[rank * job.stored + BLOCK * block..];
            let Some(a) = row.first_chunk::<BLOCK>() else { continue };
            let mut s = *flow;
            s.add_product(a[0], &g[0]);
            s.add_product(a[1], &g[1]);
            s.add_product(a[2], &g[2]);
            s.add_product(a[3], &g[3]);
            *flow = s;
        }
    }
    weights.clear();
    weights.resize(entries.len(), Lanes::ZERO);
    // Sum of w_j s_j over the splats behind.
    let mut behind = Lanes::ZERO;
    for ((e, flow), weight) in entries.iter().zip(flow.iter_mut()).zip(weights.iter_mut()).rev() {
        let (s, t) = (*flow, &e.transmittance);
        let alpha = Lanes::from_fn(|i| capped(e.alpha.0[i]));
        let by_alpha = Lanes::from_fn(|i| t.0[i] * s.0[i] - behind.0[i] / (1.0 - alpha.0[i]));
        *weight = Lanes::from_fn(|i| t.0[i] * alpha.0[i]);
        behind.add_products(weight, &s);
        let is_free = |i: usize| e.alpha.0[i] < ALPHA_MAX;
        *flow = Lanes::from_fn(|i| if is_free(i) { by_alpha.0[i] * alpha.0[i] } else { 0.0 });
    }
}

/// Adds the strip whose first pixel is (`x`, `y`) to the per-splat sums.
#[inline(always)]
fn collect((x, y): (usize, usize), width: usize, scratch: &mut BackwardScratch) {
    let BackwardScratch { blend, sums, flow, weights, gradient } = scratch;
    for (e, flow) in blend.entries.iter().zip(flow.iter()) {
        let local = e.local as usize;
        let splat = &blend.splats[local];
        let (x0, dy, [a, b, c]) = (splat.dx(x), splat.dy(y), splat.conic());
        let pull = Lanes::from_fn(|i| {
            let dx = x0 + i as f32;
            let (gx, gy) = (a * dx + b * dy, b * dx + c * dy);
            (gx * gx + gy * gy).sqrt() * flow.0[i].abs()
        });
        let Some(sums) = sums[local * width..].first_chunk_mut::<MOMENTS>() else { continue };
        sums[0].add_product(1.0, flow);
        sums[1].add_product(dy, flow);
        sums[2].add_product(dy * dy, flow);
        sums[3].add_product(1.0, &pull);
    }
    for (block, g) in gradient.iter().enumerate() {
        for (e, weight) in blend.entries.iter().zip(weights.iter()) {
            let first = e.local as usize * width + MOMENTS + BLOCK * block;
            let Some(sums) = sums[first..].first_chunk_mut::<BLOCK>() else { continue };
            sums[0].add_products(weight, &g[0]);
            sums[1].add_products(weight, &g[1]);
            sums[2].add_products(weight, &g[2]);
            sums[3].add_products(weight, &g[3]);
        }
    }
}
