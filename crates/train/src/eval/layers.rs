//! Metrics of G-buffer layers against ground truth: normals, albedo, and masked errors.

use crate::eval::image::{mean_squared_error, psnr_of};
use crate::eval::views::foreground;
use relume_scene::{PackedImage, Plane};

/// Mean angle between predicted and true normals, degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalErrors {
    /// Over pixels inside the ground-truth mask.
    pub foreground: f64,
    /// TensoIR's value: over every pixel, both sides blended by their alpha with the background (0, 0, 1), so that
    /// empty pixels have no error.
    pub all_pixels: f64,
}

/// Compares normals. The slices are row-major and have the same length; `mask` is the ground-truth foreground. `None`
/// if the mask is empty.
pub fn normal_errors(
    (predicted, predicted_alpha): (&[[f32; 3]], &[f32]),
    (truth, truth_alpha): (&[[f32; 3]], &[f32]),
    mask: &[bool],
) -> Option<NormalErrors> {
    let inside = mask.iter().filter(|&&m| m).count();
    if inside == 0 {
        return None;
    }
    let (mut foreground, mut all_pixels) = (0.0, 0.0);
    for (i, &covered) in mask.iter().enumerate() {
        if covered {
            foreground += angle_deg(unit(predicted[i]), unit(truth[i]));
        }
        let (p, t) = (blended(predicted[i], predicted_alpha[i]), blended(truth[i], truth_alpha[i]));
        all_pixels += angle_deg(p, t);
    }
    Some(NormalErrors { foreground: foreground / inside as f64, all_pixels: all_pixels / mask.len() as f64 })
}

pub(super) fn unit(n: [f32; 3]) -> glam::DVec3 {
    glam::DVec3::from_array(n.map(f64::from)).normalize_or_zero()
}

fn blended(n: [f32; 3], alpha: f32) -> glam::DVec3 {
    let a = f64::from(alpha.clamp(0.0, 1.0));
    (unit(n) * a + glam::DVec3::Z * (1.0 - a)).normalize_or_zero()
}

/// The angle between two unit vectors; 90 degrees when one is zero.
pub(super) fn angle_deg(a: glam::DVec3, b: glam::DVec3) -> f64 {
    // atan2 is accurate where acos of a rounded cosine near 1 is not.
    if a == glam::DVec3::ZERO || b == glam::DVec3::ZERO {
        return 90.0;
    }
    a.cross(b).length().atan2(a.dot(b)).to_degrees()
}

/// Collects ratios of ground truth to prediction over views, for the scale ambiguity of albedo and light.
#[derive(Debug, Default)]
pub struct RatioMedian {
    ratios: [Vec<f32>; 3],
}

impl RatioMedian {
    /// Adds the pixels inside `mask`. Predictions are clamped to at least 1e-6, as in TensoIR.
    pub fn add(&mut self, predicted: &[[f32; 3]], truth: &[[f32; 3]], mask: &[bool]) {
        for ((p, t), _) in predicted.iter().zip(truth).zip(mask).filter(|(_, m)| **m) {
            for (ratios, (p, t)) in self.ratios.iter_mut().zip(p.iter().zip(t)) {
                ratios.push(t / p.max(1e-6));
            }
        }
    }

    /// The per-channel median ratio (the lower one of an even number); `None` without pixels.
    pub fn median(mut self) -> Option<[f32; 3]> {
        if self.ratios[0].is_empty() {
            return None;
        }
        Some(std::array::from_fn(|k| {
            let ratios = &mut self.ratios[k];
            let middle = (ratios.len() - 1) / 2;
            *ratios.select_nth_unstable_by(middle, f32::total_cmp).1
        }))
    }
}

/// PSNR in dB of linear albedo: over the whole image, both sides on white by their alpha, and over the ground-truth
/// foreground only.
pub(crate) fn albedo_psnr(
    (predicted, predicted_alpha): (&[[f32; 3]], &[f32]),
    truth: &Plane<3>,
    image: &PackedImage,
) -> [Option<f64>; 2] {
    let shown = layer_on_white(predicted, predicted_alpha);
    let wanted = layer_on_white(&truth.values, &image.alpha());
    let whole = psnr_of(mean_squared_error(&shown, &wanted));
    let clamped: Vec<[f32; 3]> = predicted.iter().map(|p| p.map(|v| v.clamp(0.0, 1.0))).collect();
    [Some(whole), masked_psnr(&clamped, &truth.values, &foreground(image))]
}

/// A linear colour layer, clamped to [0, 1], on white by `alpha`.
fn layer_on_white(colour: &[[f32; 3]], alpha: &[f32]) -> Vec<[f32; 3]> {
    let pixel = |(c, a): (&[f32; 3], &f32)| c.map(|v| v.clamp(0.0, 1.0) * a + 1.0 - a);
    colour.iter().zip(alpha).map(pixel).collect()
}

/// PSNR in dB of the pixels inside `mask`; `None` if it is empty.
pub(crate) fn masked_psnr(a: &[[f32; 3]], b: &[[f32; 3]], mask: &[bool]) -> Option<f64> {
    let pick = |v: &[[f32; 3]]| -> Vec<[f32; 3]> {
        v.iter().zip(mask).filter(|(_, m)| **m).map(|(p, _)| *p).collect()
    };
    let (a, b) = (pick(a), pick(b));
    (!a.is_empty()).then(|| psnr_of(mean_squared_error(&a, &b)))
}

/// Mean absolute error inside `mask`; `None` if it is empty.
pub(crate) fn masked_mae(
    predicted: &[f32],
    truth: impl IntoIterator<Item = f32>,
    mask: &[bool],
) -> Option<f64> {
    let pairs = predicted.iter().zip(truth).zip(mask).filter(|(_, m)| **m);
    let errors = pairs.map(|((p, t), _)| (f64::from(*p) - f64::from(t)).abs());
    let (count, sum) = errors.fold((0usize, 0.0), |(n, s), e| (n + 1, s + e));
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    const UP: [f32; 3] = [0.0, 0.0, 1.0];
    const X: [f32; 3] = [1.0, 0.0, 0.0];

    #[test]
    fn background_lowers_only_the_all_pixel_normal_error() {
        // One of four pixels is covered; its error is 90 degrees.
        let mask = [true, false, false, false];
        let alpha = [1.0, 0.0, 0.0, 0.0];
        let zero = [0.0; 3];
        let errors =
            normal_errors((&[X, zero, zero, zero], &alpha), (&[UP, zero, zero, zero], &alpha), &mask);
        let errors = errors.unwrap();
        assert!((errors.foreground - 90.0).abs() < 1e-9 && (errors.all_pixels - 22.5).abs() < 1e-9);
    }

    #[test]
    fn floater_over_background_raises_the_all_pixel_normal_error() {
        let clean = normal_errors((&[UP, X], &[1.0, 0.0]), (&[UP, UP], &[1.0, 0.0]), &[true, false]);
        let floater = normal_errors((&[UP, X], &[1.0, 1.0]), (&[UP, UP], &[1.0, 0.0]), &[true, false]);
        assert_eq!(clean.unwrap().all_pixels, 0.0);
        assert!((floater.unwrap().all_pixels - 45.0).abs() < 1e-9);
    }

    #[test]
    fn median_ratio_ignores_outliers_and_background() {
        let truth: Vec<[f32; 3]> = (1..=99).map(|i| [i as f32 / 100.0; 3]).collect();
        let scale = [2.0f32, 0.5, 1.25];
        let mut predicted: Vec<[f32; 3]> =
            truth.iter().map(|t| std::array::from_fn(|k| t[k] / scale[k])).collect();
        predicted[..20].fill([0.0; 3]);
        let mut mask = vec![true; 99];
        mask[45..].fill(false);
        predicted[45..].fill([9.0; 3]);
        let mut ratios = RatioMedian::default();
        ratios.add(&predicted, &truth, &mask);
        let median = ratios.median().unwrap();
        (0..3).for_each(|k| assert!((median[k] / scale[k] - 1.0).abs() < 1e-5, "{median:?}"));
        // Negative control: without the mask the background determines the median.
        let mut unmasked = RatioMedian::default();
        unmasked.add(&predicted, &truth, &[true; 99]);
        assert!((unmasked.median().unwrap()[0] / scale[0] - 1.0).abs() > 0.1);
        assert_eq!(RatioMedian::default().median(), None);
    }

    #[test]
    fn masked_error_uses_only_the_mask_and_propagates_nan() {
        let error = masked_mae(&[0.5, 0.75, 9.0], [0.25, 1.0, 0.0], &[true, true, false]);
        assert_eq!(error, Some(0.25));
        assert!(masked_mae(&[f32::NAN, 0.5], [0.5, 0.5], &[true, true]).is_some_and(f64::is_nan));
        assert_eq!(masked_mae(&[1.0], [0.0], &[false]), None);
    }

    #[test]
    fn masked_psnr_uses_only_the_masked_pixels() {
        let psnr = masked_psnr(&[[0.1; 3], [1.0; 3]], &[[0.0; 3], [0.0; 3]], &[true, false]);
        assert!((psnr.unwrap() - 20.0).abs() < 1e-5);
    }
}
