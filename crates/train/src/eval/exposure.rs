//! Matches images to the exposure and white balance of a photograph, so that automatic camera settings do not lower a
//! model's scores.

use crate::eval::image::DisplayImage;
use relume_scene::{Plane, srgb};

/// `predicted`, which is composited on white by `alpha`, multiplied by one linear gain per channel: the gain that
/// minimises the squared difference from `truth` in linear light.
pub(crate) fn matched(predicted: &DisplayImage, alpha: &[f32], truth: &DisplayImage) -> DisplayImage {
    let alpha = |i: usize| alpha.get(i).map_or(1.0, |a| a.clamp(0.0, 1.0));
    let subject = |v: f32, a: f32| srgb::decode((v - (1.0 - a)) / a.max(1e-6));
    let mut gain = [1.0f32; 3];
    for (c, gain) in gain.iter_mut().enumerate() {
        let (mut product, mut square) = (0.0f64, 0.0f64);
        for (i, (p, t)) in predicted.values.iter().zip(&truth.values).enumerate() {
            let a = alpha(i);
            let (p, t) = (f64::from(subject(p[c], a)), f64::from(subject(t[c], a)));
            product += f64::from(a) * p * t;
            square += f64::from(a) * p * p;
        }
        if product > 0.0 && square > 0.0 {
            *gain = (product / square) as f32;
        }
    }
    let pixel = |(i, p): (usize, &[f32; 3])| {
        let a = alpha(i);
        std::array::from_fn(|c| srgb::encode(gain[c] * subject(p[c], a)) * a + 1.0 - a)
    };
    let values = predicted.values.iter().enumerate().map(pixel).collect();
    Plane { width: predicted.width, height: predicted.height, values }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eval::image::psnr;

    /// Colours on white by `alpha`, with exposure `gain`.
    fn picture(alpha: &[f32], gain: [f32; 3]) -> DisplayImage {
        let pixel = |(i, a): (usize, &f32)| {
            std::array::from_fn(|c| srgb::encode(gain[c] * 0.05 * (1 + (i + c) % 7) as f32) * a + 1.0 - a)
        };
        Plane { width: 10, height: 4, values: alpha.iter().enumerate().map(pixel).collect() }
    }

    #[test]
    fn matching_removes_exposure_and_white_balance_differences() {
        let alpha: Vec<f32> = (0..40).map(|i| [0.0, 0.5, 1.0, 1.0][i % 4]).collect();
        let (plain, photograph) = (picture(&alpha, [1.0; 3]), picture(&alpha, [1.3, 1.1, 0.8]));
        let same = matched(&plain, &alpha, &photograph);
        assert!(psnr(&same, &photograph) > 60.0);
        assert!(psnr(&plain, &photograph) < 30.0, "the control: without a gain");
        assert_eq!(same.values[0], [1.0; 3]);
    }

    #[test]
    fn matching_does_not_hide_wrong_shapes() {
        let alpha = vec![1.0; 40];
        let (plain, mut other) = (picture(&alpha, [1.0; 3]), picture(&alpha, [1.0; 3]));
        other.values.reverse();
        assert!(psnr(&matched(&plain, &alpha, &other), &other) < 25.0);
        let black = Plane { values: vec![[0.0; 3]; 40], ..plain.clone() };
        assert!(matched(&black, &alpha, &plain).values.iter().flatten().all(|v| *v == 0.0));
    }
}
