//! Sharpness of a photograph.

use relume_scene::ImageRgba;

/// Longest side at which photographs are compared, pixels. At this size sensor noise does not count as sharpness.
pub(super) const SIDE: u32 = 800;

/// Variance of the Laplacian of luma, in squared 8-bit levels. It depends on the scene: compare only photographs of
/// the same scene at the same size. 0 for images of fewer than 3 x 3 pixels.
pub(super) fn sharpness(image: &ImageRgba) -> f64 {
    let (width, height) = (image.width as usize, image.height as usize);
    if width < 3 || height < 3 {
        return 0.0;
    }
    let luma: Vec<f64> = image.pixels.iter().map(|pixel| luma(pixel) * 255.0).collect();
    let (mut sum, mut squares) = (0.0, 0.0);
    for y in 1..height - 1 {
        for x in 1..width - 1 {
            let i = y * width + x;
            let around = luma[i - 1] + luma[i + 1] + luma[i - width] + luma[i + width];
            let laplacian = around - 4.0 * luma[i];
            sum += laplacian;
            squares += laplacian * laplacian;
        }
    }
    let count = ((width - 2) * (height - 2)) as f64;
    squares / count - (sum / count).powi(2)
}

/// Luma of a display-referred pixel, Rec.709, 0 to 1.
pub(super) fn luma([r, g, b, _]: &[f32; 4]) -> f64 {
    0.2126 * f64::from(*r) + 0.7152 * f64::from(*g) + 0.0722 * f64::from(*b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blurred_image_has_lower_sharpness() {
        let stripes = |period: usize| {
            let grey = |i: usize| if (i % 32 / period).is_multiple_of(2) { 0.2 } else { 0.8 };
            let pixels = (0..32 * 32).map(|i| [grey(i), grey(i), grey(i), 1.0]).collect();
            ImageRgba { width: 32, height: 32, pixels }
        };
        let sharp = stripes(4);
        let mean = |i: usize, k: usize| (0..5).map(|d| sharp.pixels[(i + d).min(1023)][k]).sum::<f32>() / 5.0;
        let pixels = (0..32 * 32).map(|i| [0, 1, 2, 3].map(|k| mean(i, k))).collect();
        let blurred = ImageRgba { pixels, ..sharp };
        assert!(sharpness(&stripes(4)) > 2.0 * sharpness(&blurred) && sharpness(&blurred) > 0.0);
        assert_eq!(sharpness(&stripes(64)), 0.0, "no contrast");
    }
}
