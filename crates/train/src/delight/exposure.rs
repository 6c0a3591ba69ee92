//! A photograph in the exposure of a model's picture.

use super::Surfaces;
use super::detail::MatchedPhotograph;
use relume_capture::CaptureView;
use relume_engine::linear_from_srgb;
use relume_scene::srgb;

/// Display values that are used for the ratio: neither noise nor clipped.
const INFORMATIVE: std::ops::RangeInclusive<f32> = 0.06..=0.94;
/// Display value from which a pixel is clipped.
const CLIPPED: f32 = 0.985;
/// Mask value from which a pixel shows only the object.
const MIN_MASK: f32 = 0.98;
/// Least number of pixels for a ratio.
const MIN_PIXELS: usize = 50;

/// The photograph of `view` divided, by channel, by its median ratio to the picture of `surfaces`: cameras choose exposure and white balance
/// for each photograph.
pub(super) fn matched(view: &CaptureView, surfaces: &Surfaces) -> MatchedPhotograph {
    let pixels: Vec<[f32; 4]> = view.image.pixels().collect();
    let light: Vec<[f32; 3]> = pixels.iter().map(|&[r, g, b, _]| [r, g, b].map(linear_from_srgb)).collect();
    let white = view.image.range().white();
    let is_usable = |[r, g, b, a]: &[f32; 4]| *a >= MIN_MASK && r.max(*g).max(*b) < CLIPPED * white;
    let is_usable: Vec<bool> = pixels.iter().map(is_usable).collect();
    let picture = |i: usize, c: usize| surfaces.diffuse[i][c] + surfaces.specular[i][c];
    let compared: Vec<usize> = (0..pixels.len())
        .filter(|i| is_usable[*i] && surfaces.alpha[*i] > 0.9)
        .filter(|i| (0..3).all(|c| INFORMATIVE.contains(&pixels[*i][c])))
        .filter(|i| (0..3).all(|c| INFORMATIVE.contains(&srgb::encode(picture(*i, c)))))
        .collect();
    let gain = |c: usize| {
        let mut ratios: Vec<f32> = compared.iter().map(|i| light[*i][c] / picture(*i, c)).collect();
        if ratios.len() < MIN_PIXELS {
            return 1.0;
        }
        let middle = ratios.len() / 2;
        *ratios.select_nth_unstable_by(middle, f32::total_cmp).1
    };
    let gains: [f32; 3] = std::array::from_fn(gain);
    let divided = |pixel: &[f32; 3]| std::array::from_fn(|c| pixel[c] / gains[c]);
    MatchedPhotograph { light: light.iter().map(divided).collect(), is_usable }
}
