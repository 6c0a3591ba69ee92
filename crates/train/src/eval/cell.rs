//! The cells of a contact sheet: one size for all pictures of a view.

use crate::eval::image::DisplayImage;
use relume_scene::Plane;

/// Longer side of a cell, pixels. At 320 pixels needles, floaters and shadows in the albedo are visible without
/// enlarging the sheet, and its nine columns are 3,000 pixels wide.
pub const CELL: u32 = 320;

/// The size of the cell of a view of `width` x `height` pixels: the same aspect, [`CELL`] pixels on the longer side.
pub(super) fn cell_size((width, height): (u32, u32)) -> (u32, u32) {
    let longest = u64::from(width.max(height).max(1));
    let scaled = |n: u32| ((u64::from(n) * u64::from(CELL) + longest / 2) / longest).max(1) as u32;
    (scaled(width), scaled(height))
}

/// The picture at the size of its cell. A larger picture is averaged. A smaller one is enlarged bilinearly, however
/// small it is: the model is rendered at the size of the cell, and both can be compared only at one size.
pub(super) fn at_cell_size(picture: &DisplayImage, size: (u32, u32)) -> DisplayImage {
    let stored = (picture.width, picture.height);
    match stored == size {
        true => picture.clone(),
        false if stored.0 >= size.0 && stored.1 >= size.1 => picture.resized(size.0, size.1),
        false => enlarged(picture, size),
    }
}

/// Bilinear interpolation between the centres of the pixels; constant beyond the outermost centres.
fn enlarged(picture: &DisplayImage, (width, height): (u32, u32)) -> DisplayImage {
    let columns: Vec<_> = (0..width).map(|x| neighbours(x, width, picture.width)).collect();
    let at = |x: usize, y: usize| picture.values[y * picture.width as usize + x];
    let mix = |a: [f32; 3], b: [f32; 3], t: f32| std::array::from_fn(|k| a[k] + (b[k] - a[k]) * t);
    let mut values = Vec::with_capacity(width as usize * height as usize);
    for y in 0..height {
        let (y0, y1, v) = neighbours(y, height, picture.height);
        let pixel = |&(x0, x1, u): &(usize, usize, f32)| {
            mix(mix(at(x0, y0), at(x1, y0), u), mix(at(x0, y1), at(x1, y1), u), v)
        };
        values.extend(columns.iter().map(pixel));
    }
    Plane { width, height, values }
}

/// The two old pixels around the centre of new pixel `i` of `to`, and the weight of the second, 0 to 1.
fn neighbours(i: u32, to: u32, from: u32) -> (usize, usize, f32) {
    let last = from.saturating_sub(1);
    let place = (f64::from(i) + 0.5) * f64::from(from) / f64::from(to) - 0.5;
    let place = place.clamp(0.0, f64::from(last));
    let first = place.floor();
    (first as usize, (first as usize + 1).min(last as usize), (place - first) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_keep_the_aspect_of_portrait_and_landscape_views() {
        assert_eq!(cell_size((4000, 3000)), (320, 240));
        assert_eq!(cell_size((1080, 1920)), (180, 320));
        assert_eq!(cell_size((96, 96)), (320, 320));
        assert_eq!(cell_size((9, 16)), (180, 320), "small views are enlarged");
        assert_eq!(cell_size((100_000, 3)), (320, 1));
    }

    #[test]
    fn enlarging_interpolates_and_reducing_averages() {
        let ramp = |n: u32| Plane { width: n, height: 1, values: (0..n).map(|i| [i as f32; 3]).collect() };
        let large = at_cell_size(&ramp(2), (8, 4));
        assert_eq!((large.width, large.height, large.values.len()), (8, 4, 32));
        let row: Vec<f32> = large.values[..8].iter().map(|v| v[0]).collect();
        assert_eq!(row, [0.0, 0.0, 0.125, 0.375, 0.625, 0.875, 1.0, 1.0]);
        assert_eq!(at_cell_size(&ramp(4), (2, 1)).values, [[0.5; 3], [2.5; 3]]);
        assert_eq!(at_cell_size(&ramp(4), (4, 1)), ramp(4));
    }
}
