//! Photographs of charts for tests.

use glam::{DVec2, DVec3};

use crate::colour_chart::reference::{COLUMNS, ROWS};
use crate::colour_chart::sampling::{homography, mapped};
use relume_scene::{ImageRgba, srgb};

/// Width and height of the photographs, pixels.
pub(super) const SIZE: (u32, u32) = (160, 120);
/// The corners of a chart in perspective.
pub(super) const CORNERS: [DVec2; 4] =
    [DVec2::new(22.0, 14.0), DVec2::new(140.0, 24.0), DVec2::new(131.0, 99.0), DVec2::new(30.0, 108.0)];
/// Distance of the patches over their size.
const GAP: f64 = 0.15;

/// A photograph of a chart at `corners` on a dark frame, whose patches have these linear colours, with values in [0, 1].
pub(super) fn photograph(corners: [DVec2; 4], colour: impl Fn(usize) -> DVec3) -> ImageRgba {
    let inverse = homography(corners).unwrap().inverse();
    let (width, height) = SIZE;
    let count = DVec2::new(COLUMNS as f64, ROWS as f64);
    let pixel = |i: u32| {
        let at = DVec2::new(f64::from(i % width) + 0.5, f64::from(i / width) + 0.5);
        let at = mapped(&inverse, at) * (count + GAP * (count - 1.0)) / (1.0 + GAP);
        let is_patch =
            at.min_element() >= 0.0 && at.cmplt(count).all() && at.fract().max_element() * (1.0 + GAP) <= 1.0;
        let index = at.y.max(0.0) as usize * COLUMNS + at.x.max(0.0) as usize;
        let linear = if is_patch { colour(index) } else { DVec3::splat(0.02) };
        let [r, g, b] = linear.to_array().map(|v| srgb::encode(v as f32).clamp(0.0, 1.0));
        [r, g, b, 1.0]
    };
    ImageRgba { width, height, pixels: (0..width * height).map(pixel).collect() }
}
