//! Metrics that compare two display-referred images: PSNR and SSIM.

use relume_scene::Plane;

/// A display-referred RGB image, values in [0, 1].
pub type DisplayImage = Plane<3>;

/// SSIM's window: a Gaussian with 11 taps per side.
const TAPS: usize = 11;
const SIGMA: f64 = 1.5;
/// SSIM's stabilisers for images in [0, 1].
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// The PSNR of identical images, dB. The error at this PSNR is far below one 8-bit level.
pub const PSNR_CAP: f64 = 100.0;

/// Mean squared error over all pixels and channels. Both slices have the same length.
pub fn mean_squared_error<const C: usize>(a: &[[f32; C]], b: &[[f32; C]]) -> f64 {
    let square = |(p, q): (&[f32; C], &[f32; C])| -> f64 {
        p.iter().zip(q).map(|(x, y)| f64::from(x - y).powi(2)).sum()
    };
    a.iter().zip(b).map(square).sum::<f64>() / (a.len().max(1) * C) as f64
}

/// Peak signal-to-noise ratio in dB for a peak of 1, at most [`PSNR_CAP`].
pub fn psnr_of(mean_squared_error: f64) -> f64 {
    // Not `f64::min`, which would turn NaN into the cap.
    let psnr = -10.0 * mean_squared_error.log10();
    if psnr > PSNR_CAP { PSNR_CAP } else { psnr }
}

/// PSNR in dB over the whole image, at most [`PSNR_CAP`].
pub fn psnr(a: &DisplayImage, b: &DisplayImage) -> f64 {
    psnr_of(mean_squared_error(&a.values, &b.values))
}

/// Structural similarity in [-1, 1]: 11x11 Gaussian window (sigma 1.5) over the *valid* region only, as in TensoIR
/// and mip-NeRF, per channel, then the mean. `None` below 11 pixels per side.
pub fn ssim(a: &DisplayImage, b: &DisplayImage) -> Option<f64> {
    let (width, height) = (a.width as usize, a.height as usize);
    if width < TAPS || height < TAPS || (a.width, a.height) != (b.width, b.height) {
        return None;
    }
    let total: f64 = (0..3).map(|k| channel_ssim(&channel(a, k), &channel(b, k), width)).sum();
    Some(total / 3.0)
}

fn channel(picture: &DisplayImage, k: usize) -> Vec<f64> {
    picture.values.iter().map(|p| f64::from(p[k])).collect()
}

fn channel_ssim(a: &[f64], b: &[f64], width: usize) -> f64 {
    let product = |x: &[f64], y: &[f64]| -> Vec<f64> { x.iter().zip(y).map(|(p, q)| p * q).collect() };
    let (mean_a, mean_b) = (blurred(a, width), blurred(b, width));
    let (aa, bb, ab) =
        (blurred(&product(a, a), width), blurred(&product(b, b), width), blurred(&product(a, b), width));
    let similarity = |i: usize| {
        let (ma, mb) = (mean_a[i], mean_b[i]);
        let (va, vb) = ((aa[i] - ma * ma).max(0.0), (bb[i] - mb * mb).max(0.0));
        let covariance = ab[i] - ma * mb;
        (2.0 * ma * mb + C1) * (2.0 * covariance + C2) / ((ma * ma + mb * mb + C1) * (va + vb + C2))
    };
    (0..mean_a.len()).map(similarity).sum::<f64>() / mean_a.len() as f64
}

/// The valid part of a separable Gaussian blur of a row-major image.
fn blurred(image: &[f64], width: usize) -> Vec<f64> {
    let kernel = window();
    let height = image.len() / width;
    let (out_width, out_height) = (width - TAPS + 1, height - TAPS + 1);
    let along_row = |row: &[f64]| -> Vec<f64> {
        row.windows(TAPS).map(|w| w.iter().zip(&kernel).map(|(v, k)| v * k).sum()).collect()
    };
    let rows: Vec<f64> = image.chunks_exact(width).flat_map(along_row).collect();
    let at = |x: usize, y: usize| -> f64 {
        kernel.iter().enumerate().map(|(t, k)| k * rows[(y + t) * out_width + x]).sum()
    };
    (0..out_height).flat_map(|y| (0..out_width).map(move |x| (x, y))).map(|(x, y)| at(x, y)).collect()
}

fn window() -> [f64; TAPS] {
    let centre = (TAPS / 2) as f64;
    let raw: [f64; TAPS] =
        std::array::from_fn(|i| (-(i as f64 - centre).powi(2) / (2.0 * SIGMA * SIGMA)).exp());
    let sum: f64 = raw.iter().sum();
    raw.map(|v| v / sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn textured(shift: f32) -> DisplayImage {
        let value = |i: usize| {
            let (x, y) = ((i % 24) as f32, (i / 24) as f32);
            [0.5 + 0.3 * (0.9 * x).sin() + shift, 0.5 + 0.3 * (0.7 * y).cos(), ((x * y) / 600.0).min(1.0)]
        };
        Plane { width: 24, height: 20, values: (0..480).map(value).collect() }
    }

    #[test]
    fn psnr_of_a_constant_error_matches_its_square() {
        let a = Plane { width: 2, height: 2, values: vec![[0.5; 3]; 4] };
        let b = Plane { values: vec![[0.6; 3]; 4], ..a.clone() };
        assert!((psnr(&a, &b) - 20.0).abs() < 1e-5);
        assert_eq!(psnr(&a, &a), PSNR_CAP);
        let poisoned = Plane { values: vec![[f32::NAN; 3]; 4], ..a.clone() };
        assert!(psnr(&a, &poisoned).is_nan(), "NaN must not give a score");
    }

    #[test]
    fn ssim_is_one_for_equal_images_and_falls_with_noise() {
        let a = textured(0.0);
        assert!((ssim(&a, &a).unwrap() - 1.0).abs() < 1e-12);
        let brighter = ssim(&a, &textured(0.02)).unwrap();
        let mut noisy = a.clone();
        noisy.values.iter_mut().enumerate().for_each(|(i, p)| p[0] += if i % 2 == 0 { 0.3 } else { -0.3 });
        let noisy = ssim(&a, &noisy).unwrap();
        assert!(brighter > 0.99 && noisy < 0.9, "{brighter} {noisy}");
    }

    #[test]
    fn ssim_of_flat_images_is_the_luminance_term() {
        let flat = |v: f32| Plane { width: 12, height: 11, values: vec![[v; 3]; 132] };
        let (p, q) = (f64::from(0.2f32), f64::from(0.6f32));
        let expected = (2.0 * p * q + C1) / (p * p + q * q + C1);
        assert!((ssim(&flat(0.2), &flat(0.6)).unwrap() - expected).abs() < 1e-9);
    }

    #[test]
    fn image_smaller_than_the_window_has_no_ssim() {
        let a = Plane { width: 10, height: 30, values: vec![[0.5; 3]; 300] };
        assert_eq!(ssim(&a, &a), None);
    }
}
