//! Image term: mean absolute error and structural similarity (Eq. 30).
//!
//! SSIM has an 11-tap Gaussian window, sigma 1.5, zero padding, and is the mean over all pixels and channels (the form of
//! 3DGS). The photograph's own statistics are computed once for both branches.

use multiversion::multiversion;
use rayon::prelude::*;

use crate::cpu::objective::sign;
use crate::objective::ImageWeights;
use relume_layout::constants::{SSIM_C1, SSIM_C2, SSIM_TAPS, ssim_window};

/// A photograph with its window statistics, planar.
#[derive(Debug, Clone)]
pub struct Target<'p> {
    width: usize,
    height: usize,
    /// Row-major RGB.
    pub pixels: &'p [[f32; 3]],
    channels: Vec<ChannelStatistics>,
}

/// One colour channel of a photograph.
#[derive(Debug, Clone)]
struct ChannelStatistics {
    plane: Vec<f32>,
    mean: Vec<f32>,
    mean_of_square: Vec<f32>,
}

/// Value and gradient of the image term for one branch.
#[derive(Debug, Clone, Default)]
pub struct ImageLoss {
    /// Mean absolute error.
    pub mae: f32,
    /// Mean SSIM.
    pub ssim: f32,
    /// Mean squared error.
    pub mse: f32,
    /// Gradient of `l1 mae + ssim (1 - SSIM)` by pixel.
    pub gradient: Vec<[f32; 3]>,
}

impl ImageLoss {
    /// `l1 mae + ssim (1 - SSIM)`.
    pub fn value(&self, weights: ImageWeights) -> f32 {
        weights.l1 * self.mae + weights.ssim * (1.0 - self.ssim)
    }
}

impl<'p> Target<'p> {
    /// Prepares a row-major photograph.
    pub fn new(width: usize, height: usize, pixels: &'p [[f32; 3]]) -> Self {
        let statistics = |c: usize| {
            let plane: Vec<f32> = pixels.iter().map(|p| p[c]).collect();
            let squares: Vec<f32> = plane.iter().map(|v| v * v).collect();
            let (mean, mean_of_square) =
                rayon::join(|| blur(width, height, &plane), || blur(width, height, &squares));
            ChannelStatistics { plane, mean, mean_of_square }
        };
        let channels = [0, 1, 2].into_par_iter().map(statistics).collect();
        Self { width, height, pixels, channels }
    }

    /// Compares an image with the photograph; weights as in docs/MODEL.md, section 5.
    pub fn compare(&self, image: &[[f32; 3]], weights: ImageWeights) -> ImageLoss {
        let ImageWeights { l1, ssim } = weights;
        let scale = 1.0 / (3 * image.len()).max(1) as f32;
        let channels: Vec<(f64, Vec<f32>)> =
            (0..3).into_par_iter().map(|c| self.ssim_channel(image, c, -ssim * scale)).collect();
        let mut out = ImageLoss { gradient: vec![[0.0; 3]; image.len()], ..ImageLoss::default() };
        let rows = out.gradient.par_chunks_mut(self.width.max(1)).enumerate();
        let sums: Vec<[f64; 2]> = rows
            .map(|(y, row)| {
                let mut sums = [0.0f64; 2];
                for (x, pixel) in row.iter_mut().enumerate() {
                    let i = y * self.width + x;
                    for c in 0..3 {
                        let d = image[i][c] - self.pixels[i][c];
                        sums[0] += f64::from(d.abs());
                        sums[1] += f64::from(d * d);
                        pixel[c] = l1 * scale * sign(d) + channels[c].1[i];
                    }
                }
                sums
            })
            .collect();
        let [absolute, squared] = sums.iter().fold([0.0; 2], |[a, s], row| [a + row[0], s + row[1]]);
        out.mae = (absolute * f64::from(scale)) as f32;
        out.mse = (squared * f64::from(scale)) as f32;
        out.ssim = (channels.iter().map(|c| c.0).sum::<f64>() * f64::from(scale)) as f32;
        out
    }

    /// Sum of SSIM over the channel and `weight` times its gradient.
    fn ssim_channel(&self, image: &[[f32; 3]], c: usize, weight: f32) -> (f64, Vec<f32>) {
        let (w, h) = (self.width, self.height);
        let a: Vec<f32> = image.iter().map(|p| p[c]).collect();
        let ChannelStatistics { plane: b, mean: mean_b, mean_of_square: mean_bb } = &self.channels[c];
        let squares: Vec<f32> = a.iter().map(|v| v * v).collect();
        let products: Vec<f32> = a.iter().zip(b).map(|(x, y)| x * y).collect();
        let (mean_a, mean_aa) = (blur(w, h, &a), blur(w, h, &squares));
        let mean_ab = blur(w, h, &products);
        let n = a.len();
        let mut by = [0; 3].map(|_| vec![0.0f32; n]);
        let mut similarity = vec![0.0f32; n];
        let means = Means { a: &mean_a, b: mean_b, aa: &mean_aa, bb: mean_bb, ab: &mean_ab };
        similarities(&means, weight, &mut similarity, &mut by);
        let total = similarity.iter().map(|s| f64::from(*s)).sum();
        let [by_mean, by_square, by_product] = by;
        // The window is symmetric, so its transpose is itself.
        let (gm, gs, gp) = (blur(w, h, &by_mean), blur(w, h, &by_square), blur(w, h, &by_product));
        (total, (0..n).map(|i| gm[i] + 2.0 * a[i] * gs[i] + b[i] * gp[i]).collect())
    }
}

/// Means over the window of two images, of their squares and of their product.
struct Means<'a> {
    a: &'a [f32],
    b: &'a [f32],
    aa: &'a [f32],
    bb: &'a [f32],
    ab: &'a [f32],
}

/// SSIM of each pixel, and `weight` times its derivatives by the means of the first image, of its square and of the product.
#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "aarch64+neon"))]
fn similarities(means: &Means<'_>, weight: f32, similarity: &mut [f32], by: &mut [Vec<f32>; 3]) {
    let n = similarity.len();
    let [by_mean, by_square, by_product] = by.each_mut().map(|by| &mut by[..n]);
    let (a, b) = (&means.a[..n], &means.b[..n]);
    let (aa, bb, ab) = (&means.aa[..n], &means.bb[..n], &means.ab[..n]);
    for i in 0..n {
        let (ma, mb) = (a[i], b[i]);
        let (va, vb, cov) = (aa[i] - ma * ma, bb[i] - mb * mb, ab[i] - ma * mb);
        let (n1, n2) = (2.0 * ma * mb + SSIM_C1, 2.0 * cov + SSIM_C2);
        let (d1, d2) = (ma * ma + mb * mb + SSIM_C1, va + vb + SSIM_C2);
        let s = n1 * n2 / (d1 * d2);
        similarity[i] = s;
        let by_cov = 2.0 * n1 / (d1 * d2);
        let by_va = -s / d2;
        let by_ma = 2.0 * mb * n2 / (d1 * d2) - 2.0 * ma * s / d1;
        by_mean[i] = weight * (by_ma - 2.0 * ma * by_va - mb * by_cov);
        by_square[i] = weight * by_va;
        by_product[i] = weight * by_cov;
    }
}

/// Number of pixels whose sums stay in registers.
const BLOCK: usize = 32;

/// Separable Gaussian blur with zero padding.
fn blur(width: usize, height: usize, input: &[f32]) -> Vec<f32> {
    let mut across = vec![0.0f32; input.len()];
    blur_across(width, input, &mut across);
    let mut out = vec![0.0f32; input.len()];
    blur_down(width, height, &across, &mut out);
    out
}

#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "aarch64+neon"))]
fn blur_across(width: usize, input: &[f32], out: &mut [f32]) {
    let taps = ssim_window();
    let half = SSIM_TAPS / 2;
    // Whole blocks, and the window beyond the last.
    let mut padded = vec![0.0f32; width.next_multiple_of(BLOCK) + SSIM_TAPS];
    for (row, out) in input.chunks_exact(width).zip(out.chunks_exact_mut(width)) {
        padded[half..half + width].copy_from_slice(row);
        for (block, out) in out.chunks_mut(BLOCK).enumerate() {
            let mut sums = [0.0f32; BLOCK];
            for (t, k) in taps.iter().enumerate() {
                let Some(source) = padded[block * BLOCK + t..].first_chunk::<BLOCK>() else { continue };
                (0..BLOCK).for_each(|i| sums[i] += k * source[i]);
            }
            out.copy_from_slice(&sums[..out.len()]);
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "aarch64+neon"))]
fn blur_down(width: usize, height: usize, input: &[f32], out: &mut [f32]) {
    let taps = ssim_window();
    let half = SSIM_TAPS / 2;
    for (y, out) in out.chunks_exact_mut(width).enumerate() {
        let rows = half.saturating_sub(y)..SSIM_TAPS.min(height + half - y);
        for (block, out) in out.chunks_mut(BLOCK).enumerate() {
            let at = |t: usize| (y + t - half) * width + block * BLOCK;
            if let Some(out) = out.first_chunk_mut::<BLOCK>() {
                let mut sums = [0.0f32; BLOCK];
                for t in rows.clone() {
                    let Some(source) = input[at(t)..].first_chunk::<BLOCK>() else { continue };
                    (0..BLOCK).for_each(|i| sums[i] += taps[t] * source[i]);
                }
                *out = sums;
            } else {
                for t in rows.clone() {
                    let source = &input[at(t)..at(t) + out.len()];
                    out.iter_mut().zip(source).for_each(|(o, v)| *o += taps[t] * v);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(n: usize, seed: u32) -> Vec<[f32; 3]> {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 16_777_216.0
        };
        (0..n).map(|_| [next(), next(), next()]).collect()
    }

    #[test]
    fn equal_images_have_ssim_one_and_other_images_do_not() {
        let pixels = noise(24 * 20, 1);
        let target = Target::new(24, 20, &pixels);
        let same = target.compare(&pixels, ImageWeights { l1: 1.0, ssim: 1.0 });
        assert!((same.ssim - 1.0).abs() < 1e-5 && same.mae == 0.0);
        let other = target.compare(&noise(24 * 20, 2), ImageWeights { l1: 1.0, ssim: 1.0 });
        assert!(other.ssim < 0.5 && other.mae > 0.1);
    }

    #[test]
    fn blur_equals_the_sum_over_the_ssim_window() {
        let taps = ssim_window();
        for (w, h) in [(1, 1), (3, 40), (32, 4), (70, 9)] {
            let plane: Vec<f32> = noise(w * h, 5).iter().map(|p| p[0]).collect();
            let blurred = blur(w, h, &plane);
            for (i, found) in blurred.iter().enumerate() {
                let mut sum = 0.0f64;
                for (dy, ky) in taps.iter().enumerate() {
                    for (dx, kx) in taps.iter().enumerate() {
                        let (x, y) = (i % w + dx, i / w + dy);
                        if (5..w + 5).contains(&x) && (5..h + 5).contains(&y) {
                            sum += f64::from(ky * kx) * f64::from(plane[(y - 5) * w + x - 5]);
                        }
                    }
                }
                assert!((sum - f64::from(*found)).abs() < 1e-6, "{w} x {h}, {i}: {sum} {found}");
            }
        }
    }

    #[test]
    fn image_loss_gradient_agrees_with_central_differences() {
        let (w, h) = (14, 13);
        let pixels = noise(w * h, 3);
        let target = Target::new(w, h, &pixels);
        let image = noise(w * h, 4);
        let weights = ImageWeights { l1: 0.7, ssim: 0.4 };
        let loss = |image: &[[f32; 3]]| {
            let l = target.compare(image, weights);
            f64::from(0.7 * l.mae) + f64::from(0.4 * (1.0 - l.ssim))
        };
        let analytic = target.compare(&image, weights).gradient;
        for i in [0, 5, 70, 100, w * h - 1] {
            for c in 0..3 {
                // The absolute error has no derivative where image and photograph are equal.
                if (image[i][c] - target.pixels[i][c]).abs() < 5e-3 {
                    continue;
                }
                let mut shifted = [image.clone(), image.clone()];
                shifted[0][i][c] += 4e-3;
                shifted[1][i][c] -= 4e-3;
                let numeric = (loss(&shifted[0]) - loss(&shifted[1])) / 8e-3;
                assert!(
                    (numeric - f64::from(analytic[i][c])).abs() < 5e-5,
                    "{i} {c} {numeric} {}",
                    analytic[i][c]
                );
            }
        }
    }
}
