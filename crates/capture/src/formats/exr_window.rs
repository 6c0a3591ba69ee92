//! The data window of an OpenEXR image in its display window.
//!
//! A file stores the pixels of its data window. The image is the display window; pixels that it lacks are 0 (OpenEXR
//! technical introduction, "Display Window and Data Window").

use exr::prelude::IntegerBounds;

use crate::formats::ImageFileError;

/// Share of the display window that the data window covers, 0 to 1.
///
/// # Errors
/// [`ImageFileError::Unsupported`] if the windows do not overlap.
pub(super) fn coverage(data: IntegerBounds, display: IntegerBounds) -> Result<f64, ImageFileError> {
    let covered = overlap(data, display, 0).1 as f64 * overlap(data, display, 1).1 as f64;
    if covered == 0.0 {
        return Err(ImageFileError::Unsupported("has a data window outside its display window".to_owned()));
    }
    Ok(covered / (display.size.x() as f64 * display.size.y() as f64))
}

/// The pixels of the display window, from those of the data window. Both are row-major.
pub(super) fn placed(pixels: Vec<[f32; 4]>, data: IntegerBounds, display: IntegerBounds) -> Vec<[f32; 4]> {
    if data == display {
        return pixels;
    }
    let ((from_x, width, to_x), (from_y, height, to_y)) =
        (overlap(data, display, 0), overlap(data, display, 1));
    let mut out = vec![[0.0; 4]; display.size.area()];
    for row in 0..height {
        let from = (from_y + row) * data.size.x() + from_x;
        let to = (to_y + row) * display.size.x() + to_x;
        out[to..to + width].copy_from_slice(&pixels[from..from + width]);
    }
    out
}

/// The common range of both windows on an axis: its start in the data window, its length, and its start in the display
/// window.
fn overlap(data: IntegerBounds, display: IntegerBounds, axis: usize) -> (usize, usize, usize) {
    let bounds = |window: IntegerBounds| match axis {
        0 => (i64::from(window.position.x()), window.size.x() as i64),
        _ => (i64::from(window.position.y()), window.size.y() as i64),
    };
    let ((data_start, data_length), (display_start, display_length)) = (bounds(data), bounds(display));
    let start = data_start.max(display_start);
    let end = data_start.saturating_add(data_length).min(display_start.saturating_add(display_length));
    let length = (end - start).max(0);
    if length == 0 {
        return (0, 0, 0);
    }
    ((start - data_start) as usize, length as usize, (start - display_start) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(x: i32, y: i32, width: usize, height: usize) -> IntegerBounds {
        IntegerBounds::new((x, y), (width, height))
    }

    fn reds(pixels: Vec<[f32; 4]>) -> Vec<f32> {
        pixels.iter().map(|p| p[0]).collect()
    }

    #[test]
    fn data_windows_are_placed_and_cropped() {
        let pixels: Vec<[f32; 4]> = (1..=6).map(|i| [i as f32; 4]).collect();
        let data = window(-1, 2, 3, 2);
        assert_eq!(reds(placed(pixels.clone(), data, data)), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        let display = window(0, 1, 3, 2);
        assert_eq!(reds(placed(pixels.clone(), data, display)), [0.0, 0.0, 0.0, 2.0, 3.0, 0.0]);
        assert_eq!(coverage(data, display), Ok(2.0 / 6.0));
        assert_eq!(coverage(data, data), Ok(1.0));
        assert!(coverage(data, window(5, 5, 2, 2)).is_err());
        assert!(coverage(window(i32::MAX - 2, 0, 2, 2), window(i32::MIN, 0, 2, 2)).is_err());
    }
}
