//! Front-to-back blending of N channels in one tile (Eq. 4-5).
//!
//! A tile is processed strip by strip (one row of 16 pixels = one vector). For each strip, the first pass computes the
//! weights of the splats that reach it; the G-buffer of the strip is then the small matrix product `attributes^T x weights`,
//! four channels at a time so that the sums stay in registers. The data of a strip fits the L1 cache.

use multiversion::multiversion;

use crate::cpu::lanes::{LANES, Lanes, exp_negative};
use crate::cpu::project::Splat;
use relume_layout::constants::{ALPHA_MAX, ALPHA_MIN, EarlyStop, TILE, TRANSMITTANCE_STOP};

/// The part of a splat that a strip needs.
///
/// The exponent `0.5 d^T C d` is computed as a sum of two squares (the Cholesky factor of C). For needle-shaped splats the
/// terms of the quadratic form cancel; the sum of squares keeps its digits and cannot become negative. With `C = [a b; b c]` it is
/// `0.5 ((sqrt(a) dx + b / sqrt(a) dy)^2 + dy^2 / yy)`, since `c - b^2 / a = 1 / yy`.
#[derive(Debug, Clone, Copy)]
pub(super) struct LocalSplat {
    mean: [f32; 2],
    conic: [f32; 3],
    opacity: f32,
    reach: f32,
    /// `sqrt(a / 2)`, `b / sqrt(2 a)`.
    axes: [f32; 2],
    /// Minimum power in a row is `row_power * dy^2`.
    row_power: f32,
}

impl LocalSplat {
    fn new(s: &Splat) -> Self {
        let root = (0.5 * s.conic[0]).sqrt();
        let axes = [root, 0.5 * s.conic[1] / root];
        let row_power = 0.5 / s.covariance[2];
        Self { mean: s.mean, conic: s.conic, opacity: s.opacity, reach: s.reach, axes, row_power }
    }

    /// Offset of lane 0 of a tile at `x` from the mean.
    #[inline(always)]
    pub(super) fn dx(&self, x: usize) -> f32 {
        x as f32 + 0.5 - self.mean[0]
    }

    /// Offset of row `y` from the mean.
    #[inline(always)]
    pub(super) fn dy(&self, y: usize) -> f32 {
        y as f32 + 0.5 - self.mean[1]
    }

    /// Alpha before the cap in the strip at (`x`, `y`), 0 where below 1/255; `None` where it is 0 in every pixel.
    #[inline(always)]
    pub(super) fn alpha(&self, x: usize, y: usize) -> Option<Lanes> {
        let dy = self.dy(y);
        let least = self.row_power * dy * dy;
        if least > self.reach {
            return None;
        }
        let (x0, a, b) = (self.dx(x), self.axes[0], self.axes[1] * dy);
        let alpha = Lanes::from_fn(|i| {
            let u = a * (x0 + i as f32) + b;
            let value = self.opacity * exp_negative(-(u * u + least));
            if value >= ALPHA_MIN { value } else { 0.0 }
        });
        (alpha.max() > 0.0).then_some(alpha)
    }

    #[inline(always)]
    pub(super) fn conic(&self) -> [f32; 3] {
        self.conic
    }

    #[inline(always)]
    pub(super) fn opacity(&self) -> f32 {
        self.opacity
    }
}

/// One splat in one strip.
#[derive(Debug, Clone, Copy)]
pub(super) struct StripEntry {
    /// Position in the tile's list.
    pub(super) local: u32,
    /// Alpha before the cap, 0 where below 1/255.
    pub(super) alpha: Lanes,
    /// Transmittance in front of the splat.
    pub(super) transmittance: Lanes,
}

/// Buffers that a thread reuses for each tile.
#[derive(Debug, Default)]
pub struct BlendScratch {
    pub(super) splats: Vec<LocalSplat>,
    pub(super) entries: Vec<StripEntry>,
    weights: Vec<Lanes>,
}

/// A tile to blend: its splats and its position.
#[derive(Debug, Clone, Copy)]
pub struct TileJob<'a> {
    /// All splats.
    pub splats: &'a [Splat],
    /// Splats of this tile, front to back.
    pub members: &'a [u32],
    /// Attributes by splat, `stored` floats each.
    pub attributes: &'a [f32],
    /// Floats in an attribute row, a multiple of 4.
    pub stored: usize,
    /// Top-left pixel.
    pub origin: (usize, usize),
    /// When blending stops at a pixel.
    pub early_stop: EarlyStop,
}

impl BlendScratch {
    pub(super) fn gather(&mut self, job: &TileJob<'_>) {
        self.splats.clear();
        self.splats.extend(job.members.iter().map(|&m| LocalSplat::new(&job.splats[m as usize])));
    }

    /// Alpha and transmittance of every splat that reaches the strip at row `y`.
    #[inline(always)]
    pub(super) fn find_entries(&mut self, x: usize, y: usize, early_stop: EarlyStop) {
        self.entries.clear();
        let mut transmittance = Lanes::ONE;
        for (local, s) in self.splats.iter().enumerate() {
            let Some(alpha) = s.alpha(x, y) else { continue };
            self.entries.push(StripEntry { local: local as u32, alpha, transmittance });
            transmittance = behind_splat(&transmittance, &alpha);
            if is_finished(early_stop, self.entries.len(), &transmittance) {
                break;
            }
        }
    }
}

/// Transmittance behind a splat of `alpha`.
#[inline(always)]
pub(super) fn behind_splat(in_front: &Lanes, alpha: &Lanes) -> Lanes {
    Lanes::from_fn(|i| in_front.0[i] * (1.0 - capped(alpha.0[i])))
}

/// True when blending stops at the strip after `count` splats; tested at every fourth splat.
#[inline(always)]
pub(super) fn is_finished(early_stop: EarlyStop, count: usize, transmittance: &Lanes) -> bool {
    early_stop == EarlyStop::WhenSaturated
        && count.is_multiple_of(4)
        && transmittance.max() < TRANSMITTANCE_STOP
}

/// Alpha after the cap.
#[inline(always)]
pub(super) fn capped(alpha: f32) -> f32 {
    if alpha < ALPHA_MAX { alpha } else { ALPHA_MAX }
}

/// Blends one tile into `out`: `[row][channel][lane]`, `TILE * stored * LANES` floats.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
pub fn blend_tile(job: &TileJob<'_>, scratch: &mut BlendScratch, out: &mut [f32]) {
    scratch.gather(job);
    for row in 0..TILE {
        scratch.find_entries(job.origin.0, job.origin.1 + row, job.early_stop);
        let BlendScratch { entries, weights, .. } = &mut *scratch;
        weights.clear();
        for e in entries.iter() {
            weights.push(Lanes::from_fn(|i| e.transmittance.0[i] * capped(e.alpha.0[i])));
        }
        let strip = &mut out[row * job.stored * LANES..(row + 1) * job.stored * LANES];
        for (block, target) in strip.chunks_exact_mut(4 * LANES).enumerate() {
            let mut sums = [Lanes::ZERO; 4];
            for (e, w) in entries.iter().zip(weights.iter()) {
                let splat = job.members[e.local as usize] as usize;
                let base = splat * job.stored + 4 * block;
                let Some(a) = job.attributes[base..].first_chunk::<4>() else { continue };
                sums[0].add_product(a[0], w);
                sums[1].add_product(a[1], w);
                sums[2].add_product(a[2], w);
                sums[3].add_product(a[3], w);
            }
            for (lane_row, sum) in target.chunks_exact_mut(LANES).zip(&sums) {
                lane_row.copy_from_slice(&sum.0);
            }
        }
    }
}
