//! Exposure and white balance of single photographs.
//!
//! A phone chooses both for each photograph. The physically based branch renders every photograph under one light, so
//! the median ratio of a photograph to its rendering is its gain. (The radiance branch is unsuitable: it explains a
//! gain as view dependence.) Photographs are divided by their gains if these differ by more than model errors
//! explain.

use rayon::prelude::*;

use crate::context::StepContext;
use crate::dataset::{Dataset, Gain};
use relume_engine::{Photo, PhotoSize, TrainState, linear_from_srgb};
use relume_scene::{Camera, Plane};

/// Longest side of the images that are compared, pixels.
const SIDE: u32 = 96;
/// Display values that are used for the ratio, over the white of the range for the upper one: neither noise nor clipped.
const INFORMATIVE_RANGE: (f32, f32) = (0.06, 0.94);
/// Mask value above which a pixel shows only the object.
const MIN_FULL_MASK: f32 = 0.95;
/// Least number of pixels for a gain.
const MIN_PIXELS: usize = 50;
/// Standard deviation over the photographs above which gains are applied: of `ln(gain)` in green, or of that of red
/// or blue over green. Scenes with constant exposure stay below it (docs/decisions/0032).
const MIN_GAIN_SPREAD: f32 = 0.045;
/// Largest accepted `|ln(gain)|`.
const MAX_LOG_GAIN: f32 = 1.0;

/// Gains of the photographs of `data` relative to the physically based branch, normalised to a geometric mean of 1 in each light group:
/// the light of a group contains its mean.
pub fn gains(state: &TrainState, context: &StepContext<'_>, data: &Dataset) -> Vec<Gain> {
    let logs: Vec<[f32; 3]> = (0..data.len())
        .into_par_iter()
        .map(|i| {
            let small = reduced(&data.decode_uncached(i, PhotoSize::Full), SIDE);
            median_ratio(&small, &context.physical_image(state, &small))
        })
        .collect();
    let group = |i: usize| data.without_pixels(i, PhotoSize::Half).light.light.group;
    let groups: Vec<usize> = (0..data.len()).map(group).collect();
    let mut sums = vec![([0.0f32; 3], 0.0f32); data.lights.groups()];
    for (l, group) in logs.iter().zip(&groups) {
        (0..3).for_each(|c| sums[*group].0[c] += l[c]);
        sums[*group].1 += 1.0;
    }
    let gain = |(l, group): (&[f32; 3], &usize)| {
        let (sum, n) = sums[*group];
        std::array::from_fn(|c| (l[c] - sum[c] / n).clamp(-MAX_LOG_GAIN, MAX_LOG_GAIN).exp())
    };
    logs.iter().zip(&groups).map(gain).collect()
}

/// True when `gains` differ by more than those of photographs with constant exposure.
pub fn differ(gains: &[Gain]) -> bool {
    spread(gains).iter().any(|spread| *spread > MIN_GAIN_SPREAD)
}

/// Standard deviations of the logarithms of green, of red over green and of blue over green.
pub fn spread(gains: &[Gain]) -> [f32; 3] {
    let n = gains.len().max(1) as f32;
    let of = |value: fn(&Gain) -> f32| {
        let mean = gains.iter().map(|g| value(g).ln()).sum::<f32>() / n;
        (gains.iter().map(|g| (value(g).ln() - mean).powi(2)).sum::<f32>() / n).sqrt()
    };
    [of(|g| g[1]), of(|g| g[0] / g[1]), of(|g| g[2] / g[1])]
}

/// `camera` with a longest side of at most `most` pixels.
pub fn reduced_camera(camera: &Camera, most: u32) -> Camera {
    let longest = camera.width.max(camera.height);
    let side = |s: u32| (u64::from(s) * u64::from(most.min(longest))).div_ceil(u64::from(longest)) as u32;
    camera.resized(side(camera.width), side(camera.height))
}

/// `photo`, reduced to a longest side of at most `most` pixels.
pub fn reduced(photo: &Photo, most: u32) -> Photo {
    let (width, height) = (photo.camera.width, photo.camera.height);
    let camera = reduced_camera(&photo.camera, most);
    let (w, h) = (camera.width, camera.height);
    let pixels = Plane { width, height, values: photo.pixels.clone() }.resized(w, h).values;
    let alpha = if photo.alpha.is_empty() {
        Vec::new()
    } else {
        let values = photo.alpha.iter().map(|a| [*a]).collect();
        Plane { width, height, values }.resized(w, h).values.into_flattened()
    };
    Photo { camera, pixels, alpha, light: photo.light, range: photo.range }
}

/// Median of `ln(photograph / image)` by channel, in linear light; 0 with too few usable pixels.
fn median_ratio(photo: &Photo, image: &[[f32; 3]]) -> [f32; 3] {
    let tells = |v: &f32| (INFORMATIVE_RANGE.0..=INFORMATIVE_RANGE.1 * photo.range.white()).contains(v);
    let whole = |i: usize| photo.alpha.get(i).is_none_or(|a| *a > MIN_FULL_MASK);
    let used: Vec<usize> = (0..image.len())
        .filter(|i| whole(*i) && photo.pixels[*i].iter().chain(&image[*i]).all(tells))
        .collect();
    if used.len() < MIN_PIXELS {
        return [0.0; 3];
    }
    std::array::from_fn(|c| {
        let ratio = |i: &usize| (linear_from_srgb(photo.pixels[*i][c]) / linear_from_srgb(image[*i][c])).ln();
        let mut ratios: Vec<f32> = used.iter().map(ratio).collect();
        let middle = ratios.len() / 2;
        *ratios.select_nth_unstable_by(middle, f32::total_cmp).1
    })
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::dataset::divide;
    use relume_compare::largest_difference;
    use relume_scene::DisplayRange;

    /// A photograph of a colour ramp, half of it behind a mask.
    fn photo(alpha: bool) -> Photo {
        let camera =
            Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 0.7, (40, 20)).unwrap();
        let colour = |i: usize| std::array::from_fn(|c| 0.25 + 0.5 * ((i * 7 + c * 13) % 40) as f32 / 40.0);
        let mask = |i: usize| if i % 40 < 20 { 1.0 } else { 0.25 };
        let alpha: Vec<f32> = if alpha { (0..800).map(mask).collect() } else { Vec::new() };
        let over = |(i, p): (usize, [f32; 3])| {
            let a = alpha.get(i).copied().unwrap_or(1.0);
            p.map(|v| v * a + 1.0 - a)
        };
        let pixels = (0..800).map(colour).enumerate().map(over).collect();
        Photo { camera, pixels, alpha, light: Default::default(), range: DisplayRange::Unit }
    }

    #[test]
    fn gain_is_estimated_and_divided_out() {
        for alpha in [false, true] {
            let (plain, mut taken) = (photo(alpha), photo(alpha));
            let gain = [1.2f32, 1.1, 0.85];
            divide(&mut taken, gain.map(|g| 1.0 / g), [1.0; 3]);
            let found = median_ratio(&taken, &plain.pixels);
            (0..3).for_each(|c| assert!((found[c] - gain[c].ln()).abs() < 1e-3, "{found:?}"));
            divide(&mut taken, gain, [1.0; 3]);
            assert!(largest_difference(taken.pixels.as_flattened(), plain.pixels.as_flattened()) < 1e-4);
        }
    }

    #[test]
    fn gain_of_scene_referred_photographs_uses_pixels_above_white() {
        let brighter = |range| {
            let mut photo = Photo { range, ..photo(false) };
            photo.pixels.iter_mut().flatten().for_each(|v| *v += 1.0);
            photo
        };
        let (plain, mut taken) = (brighter(DisplayRange::Extended), brighter(DisplayRange::Extended));
        divide(&mut taken, [0.8; 3], [1.0; 3]);
        let found = median_ratio(&taken, &plain.pixels);
        assert!(found.iter().all(|log| (log - 1.25f32.ln()).abs() < 1e-3), "{found:?}");
        let clipped = brighter(DisplayRange::Unit);
        assert_eq!(median_ratio(&clipped, &plain.pixels), [0.0; 3], "the control");
    }

    #[test]
    fn too_few_usable_pixels_give_no_gain() {
        let mut dark = photo(false);
        dark.pixels.iter_mut().skip(MIN_PIXELS - 1).for_each(|p| *p = [0.01; 3]);
        let brighter: Vec<[f32; 3]> = dark.pixels.iter().map(|p| p.map(|v| v * 0.9)).collect();
        assert_eq!(median_ratio(&dark, &brighter), [0.0; 3]);
        assert!(
            median_ratio(
                &photo(false),
                &photo(false).pixels.iter().map(|p| p.map(|v| v * 0.9)).collect::<Vec<_>>()
            )[0] > 0.1
        );
    }

    #[test]
    fn gains_count_only_if_they_differ_between_photographs() {
        let of = |step: f32| -> Vec<Gain> { (0..10).map(|i| [(step * (i % 2) as f32).exp(); 3]).collect() };
        assert!(differ(&of(0.1)) && !differ(&of(0.08)) && !differ(&[]));
        assert!(!differ(&[[1.3, 1.3, 1.3]; 5]), "a common gain belongs to the light");
        let warmer: Vec<Gain> = (0..10).map(|i| [1.0 + 0.1 * (i % 2) as f32, 1.0, 1.0]).collect();
        assert!(differ(&warmer));
    }
}
