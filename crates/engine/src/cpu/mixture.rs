//! Albedo as a mixture of prototypes (article Eq. 23), sixteen Gaussians in SIMD lanes, forward and backward.
//!
//! Scores are transposed from rows to lanes, one lane per Gaussian, so that each Gaussian's sums have the order of its
//! prototypes at every register width.

use std::ops::Range;

use multiversion::multiversion;

use crate::cpu::attributes::AttributeSource;
use crate::cpu::lanes::{LANES, Lanes, exp_negative};
use relume_layout::channel;
use relume_scene::Field;

/// Buffers that a thread reuses for each block.
#[derive(Debug, Default)]
pub(super) struct MixtureScratch {
    /// Scores, then shares; one lane per Gaussian.
    shares: Vec<Lanes>,
    /// Gradient by share, then by score.
    by_scores: Vec<Lanes>,
    /// Prototypes, clamped to [0, 1].
    palette: Vec<[f32; 3]>,
}

impl MixtureScratch {
    /// Computes the prototype shares of up to sixteen Gaussians and returns their unclamped albedos, one lane each.
    fn mix(&mut self, source: &AttributeSource<'_>, gaussians: &[u32]) -> [Lanes; 3] {
        self.palette.clear();
        self.palette.extend(source.prototypes.iter().map(|a| a.map(|v| v.clamp(0.0, 1.0))));
        self.shares.clear();
        self.shares.resize(source.gaussians.prototypes(), Lanes::ZERO);
        let mut residual = [Lanes::ZERO; 3];
        for (lane, i) in gaussians.iter().enumerate() {
            let scores = source.gaussians.row(Field::ProtoLogits, *i as usize);
            self.shares.iter_mut().zip(scores).for_each(|(s, v)| s.0[lane] = *v);
            let row = source.gaussians.row(Field::Residual, *i as usize);
            residual.iter_mut().zip(row).for_each(|(r, v)| r.0[lane] = *v);
        }
        blend(&mut self.shares, &self.palette, &residual)
    }

    /// Writes the albedos of `gaussians` into their rows of attributes, `stored` floats each.
    pub(super) fn write(
        &mut self,
        source: &AttributeSource<'_>,
        gaussians: &[u32],
        rows: &mut [f32],
        stored: usize,
    ) {
        let albedo = self.mix(source, gaussians);
        for (lane, row) in rows.chunks_exact_mut(stored).enumerate() {
            for (out, a) in row[channel::ALBEDO].iter_mut().zip(&albedo) {
                *out = a.0[lane].clamp(0.0, 1.0);
            }
        }
    }

    /// Gradient by unclamped albedo of each Gaussian, from its row's gradient; 0 without a gradient.
    fn by_albedo(albedo: &[Lanes; 3], by_rows: &[Option<&[f32]>]) -> [Lanes; 3] {
        let mut by_albedo = [Lanes::ZERO; 3];
        for (lane, row) in by_rows.iter().enumerate() {
            let Some(row) = row else { continue };
            for c in 0..3 {
                let inside = albedo[c].0[lane] > 0.0 && albedo[c].0[lane] < 1.0;
                by_albedo[c].0[lane] = if inside { row[channel::ALBEDO.start + c] } else { 0.0 };
            }
        }
        by_albedo
    }

    /// Adds the gradients by residual and scores of `gaussians` to their gradient rows of `width` floats, in the given ranges
    /// of those fields.
    pub(super) fn backward(
        &mut self,
        source: &AttributeSource<'_>,
        gaussians: &[u32],
        by_rows: &[Option<&[f32]>],
        [residuals, scores]: [Range<usize>; 2],
        rows: &mut [f32],
        width: usize,
    ) {
        let albedo = self.mix(source, gaussians);
        let by_albedo = Self::by_albedo(&albedo, by_rows);
        self.by_scores.clear();
        self.by_scores.resize(self.shares.len(), Lanes::ZERO);
        blend_backward(&self.shares, &self.palette, &by_albedo, &mut self.by_scores);
        // Gaussians without a row are skipped: zero times NaN would not be 0.
        let seen = rows.chunks_exact_mut(width).zip(by_rows).enumerate().filter(|(_, (_, by))| by.is_some());
        for (lane, (row, _)) in seen {
            row[residuals.clone()].iter_mut().zip(&by_albedo).for_each(|(o, g)| *o += g.0[lane]);
            row[scores.clone()].iter_mut().zip(&self.by_scores).for_each(|(o, g)| *o += g.0[lane]);
        }
    }

    /// Adds the gradient by the prototypes, `[channel][prototype]`, of up to sixteen Gaussians, one after the other.
    pub(super) fn prototypes_backward(
        &mut self,
        source: &AttributeSource<'_>,
        gaussians: &[u32],
        by_rows: &[Option<&[f32]>],
        out: &mut [Vec<f32>; 3],
    ) {
        let albedo = self.mix(source, gaussians);
        let by_albedo = Self::by_albedo(&albedo, by_rows);
        for lane in 0..gaussians.len() {
            for (c, out) in out.iter_mut().enumerate() {
                let g = by_albedo[c].0[lane];
                out.iter_mut().zip(&self.shares).for_each(|(o, p)| *o += p.0[lane] * g);
            }
        }
    }
}

/// Softmax of `scores`, in place, lane by lane.
#[inline(always)]
pub fn softmax_lanes(scores: &mut [Lanes]) {
    let mut top = Lanes([f32::NEG_INFINITY; LANES]);
    for s in scores.iter() {
        top = Lanes::from_fn(|i| if s.0[i] > top.0[i] { s.0[i] } else { top.0[i] });
    }
    let mut total = Lanes::ZERO;
    for s in scores.iter_mut() {
        *s = Lanes::from_fn(|i| exp_negative(s.0[i] - top.0[i]));
        (0..LANES).for_each(|i| total.0[i] += s.0[i]);
    }
    for s in scores.iter_mut() {
        *s = Lanes::from_fn(|i| s.0[i] / total.0[i]);
    }
}

/// Softmax of `scores`, in place, and the mixtures of `palette` by it on top of `residual`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
fn blend(scores: &mut [Lanes], palette: &[[f32; 3]], residual: &[Lanes; 3]) -> [Lanes; 3] {
    softmax_lanes(scores);
    let mut mixed = [Lanes::ZERO; 3];
    for (share, colour) in scores.iter().zip(palette) {
        (0..3).for_each(|c| mixed[c].add_product(colour[c], share));
    }
    std::array::from_fn(|c| Lanes::from_fn(|i| residual[c].0[i] + mixed[c].0[i]))
}

/// Gradient by the scores of [`blend`] whose shares are `shares`, from that by its result.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
fn blend_backward(shares: &[Lanes], palette: &[[f32; 3]], by_albedo: &[Lanes; 3], by_scores: &mut [Lanes]) {
    let mut mean = Lanes::ZERO;
    for ((by, p), colour) in by_scores.iter_mut().zip(shares).zip(palette) {
        (0..3).for_each(|c| by.add_product(colour[c], &by_albedo[c]));
        mean.add_products(p, by);
    }
    for (by, p) in by_scores.iter_mut().zip(shares) {
        *by = Lanes::from_fn(|i| p.0[i] * (by.0[i] - mean.0[i]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_scene::{Gaussians, ShadingOptions};

    const N: usize = 21;

    fn gaussians() -> Gaussians {
        let mut g = Gaussians::zeroed(N, 5, 0, 0);
        for field in [Field::ProtoLogits, Field::Residual] {
            g.field_mut(field)
                .iter_mut()
                .enumerate()
                .for_each(|(i, v)| *v = ((i * 37) % 23) as f32 / 9.0 - 1.2);
        }
        g
    }

    /// Albedos in blocks of sixteen, and one by one.
    fn both(g: &Gaussians) -> [Vec<[f32; 3]>; 2] {
        let prototypes =
            [[0.5, 0.4, 0.3], [0.1, 1.4, 0.3], [0.9, -0.2, 0.1], [0.1, 0.2, 0.3], [0.7, 0.7, 0.6]];
        let options = ShadingOptions::default();
        let source = AttributeSource::new(g, &prototypes, &options);
        let mut scratch = MixtureScratch::default();
        let indices: Vec<u32> = (0..N as u32).collect();
        let blocks = indices.chunks(LANES).flat_map(|block| {
            let albedo = scratch.mix(&source, block);
            (0..block.len()).map(|lane| [0, 1, 2].map(|c| albedo[c].0[lane])).collect::<Vec<_>>()
        });
        [blocks.collect(), (0..N).map(|i| source.albedo(i)).collect()]
    }

    #[test]
    fn lane_evaluation_equals_scalar_evaluation() {
        let [in_lanes, alone] = both(&gaussians());
        assert_eq!(in_lanes, alone);
        assert!(alone.iter().flatten().any(|a| *a < 0.0), "the control: nothing is clamped yet");
    }

    #[test]
    fn nan_gaussian_does_not_affect_other_gaussians() {
        let fine = both(&gaussians())[0].clone();
        let mut broken = gaussians();
        broken.row_mut(Field::ProtoLogits, 3).fill(f32::NAN);
        broken.row_mut(Field::Residual, 3).fill(f32::NAN);
        let found = both(&broken)[0].clone();
        for i in 0..N {
            assert_eq!(found[i] == fine[i], i != 3, "{i}");
        }
    }
}
