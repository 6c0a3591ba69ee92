//! Backward pass of the blending in one tile.
//!
//! Per strip: the weights are found again (cheaper than keeping them), `s = A G^T` gives one scalar a splat and pixel,
//! and a back-to-front sweep turns it into the gradient of alpha. Per splat of the tile, sums over pixels are kept as
//! whole vectors over the tile's rows and reduced once at the end; a column's offset from the mean is the same in every
//! row, so three moments (1, dy, dy^2) of the alpha gradient are enough to recover all six.
//! Tried and lost: horizontal sums per strip (about 12 instructions for each of 16 sums a strip).

use multiversion::multiversion;

use crate::engine::cpu::blend::{BlendScratch, TileJob, capped};
use crate::engine::cpu::lanes::{LANES, Lanes};
use crate::engine::cpu::project::ALPHA_MAX;
use crate::engine::cpu::tiles::TILE;

/// Leading floats of a gradient row: projected mean (2), conic (3), opacity (1), then the channels.
pub const ROW_HEADER: usize = 6;

/// Vectors kept per splat in front of the channels: alpha-gradient moments 1, dy, dy^2.
const MOMENTS: usize = 3;

/// Memory a thread reuses from tile to tile.
#[derive(Debug, Default)]
pub struct BackwardScratch {
    blend: BlendScratch,
    /// `[splat][moments + channels]`.
    sums: Vec<Lanes>,
    /// `s` per entry, then the alpha gradient times alpha.
    flow: Vec<Lanes>,
    gradient: Vec<Lanes>,
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
    let width = MOMENTS + channels;
    scratch.sums.clear();
    scratch.sums.resize(job.ranks.len() * width, Lanes::ZERO);
    for row in 0..TILE {
        let strip = &gradient[row * gradient_stored * LANES..];
        scratch.gradient.clear();
        scratch.gradient.extend(strip.chunks_exact(LANES).take(channels).map(Lanes::load));
        if scratch.gradient.iter().all(|g| *g == Lanes::ZERO) {
            continue;
        }
        scratch.blend.find_entries(job.origin.0, job.origin.1 + row, job.early_stop);
        alpha_flow(job, channels, scratch);
        collect(job.origin.1 + row, width, scratch);
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
        let header = [a * x + b * y, b * x + c * y, -0.5 * xx, -xy, -0.5 * yy, one / splat.opacity()];
        target[..ROW_HEADER].copy_from_slice(&header);
        for (t, s) in target[ROW_HEADER..].iter_mut().zip(&sums[MOMENTS..]) {
            *t = s.sum();
        }
    }
}

/// Fills `flow` with `dL/d alpha * alpha` of each entry (zero where alpha is capped or cut).
#[inline(always)]
fn alpha_flow(job: &TileJob<'_>, channels: usize, scratch: &mut BackwardScratch) {
    let entries = &scratch.blend.entries;
    scratch.flow.clear();
    for e in entries {
        let rank = job.ranks[e.local as usize] as usize;
        let attributes = &job.attributes[rank * job.stored..][..channels];
        let mut s = Lanes::ZERO;
        for (a, g) in attributes.iter().zip(&scratch.gradient) {
            s.add_product(*a, g);
        }
        scratch.flow.push(s);
    }
    // Sum of w_j s_j over the splats behind.
    let mut behind = Lanes::ZERO;
    for (e, flow) in entries.iter().zip(&mut scratch.flow).rev() {
        for i in 0..LANES {
            let alpha = capped(e.alpha.0[i]);
            let t = e.transmittance.0[i];
            let s = flow.0[i];
            let by_alpha = t * s - behind.0[i] / (1.0 - alpha);
            behind.0[i] += t * alpha * s;
            let free = e.alpha.0[i] < ALPHA_MAX;
            flow.0[i] = if free { by_alpha * alpha } else { 0.0 };
        }
    }
}

/// Adds the strip to the per-splat sums.
#[inline(always)]
fn collect(y: usize, width: usize, scratch: &mut BackwardScratch) {
    for (e, flow) in scratch.blend.entries.iter().zip(&scratch.flow) {
        let local = e.local as usize;
        let dy = scratch.blend.splats[local].dy(y);
        let weight = Lanes::from_fn(|i| e.transmittance.0[i] * capped(e.alpha.0[i]));
        let sums = &mut scratch.sums[local * width..(local + 1) * width];
        sums[0].add_product(1.0, flow);
        sums[1].add_product(dy, flow);
        sums[2].add_product(dy * dy, flow);
        for (sum, g) in sums[MOMENTS..].iter_mut().zip(&scratch.gradient) {
            sum.add_products(&weight, g);
        }
    }
}
