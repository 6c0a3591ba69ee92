//! Checks what masks leave of the photographs.

use crate::error::name_list;
use crate::{CaptureError, CaptureView};
use relume_scene::PackedImage;

/// Least alpha of a pixel of the object.
const OBJECT: f32 = 0.5;
/// Greatest number of points of the grid along a side of a picture.
const GRID: usize = 256;
/// Width of the border of a picture, as a share of its sides.
const BORDER: f64 = 0.05;
/// Mean alpha of the border above which, and of the middle below which, a mask seems to be inverted.
const INVERTED: (f64, f64) = (0.8, 0.2);

/// Warnings about masks, and about alpha channels, which are masks as well.
///
/// # Errors
/// [`CaptureError::Image`] when no photograph has a pixel of the object.
pub(crate) fn check(views: &[CaptureView]) -> Result<Vec<String>, CaptureError> {
    let (mut empty, mut inverted, mut masked) = (Vec::new(), Vec::new(), 0);
    for view in views.iter().filter(|view| !view.image.is_opaque()) {
        masked += 1;
        let (alpha, size) = sampled_alpha(&view.image);
        if !alpha.iter().any(|a| *a >= OBJECT) {
            empty.push(view.name.clone());
        } else if is_inverted(&alpha, size) {
            inverted.push(view.name.clone());
        }
    }
    if masked == views.len() && empty.len() == masked && masked > 0 {
        let reason = "no photograph has a pixel of the object: white pixels of a mask, and opaque pixels of a photograph \
                      with alpha, must mark the object";
        return Err(CaptureError::Image { file: empty.swap_remove(0), reason: reason.to_owned() });
    }
    let mut warnings = Vec::new();
    if !empty.is_empty() {
        warnings.push(format!("photographs with an empty mask: {}: {}", empty.len(), name_list(&empty)));
    }
    if !inverted.is_empty() {
        warnings.push(format!(
            "photographs whose mask keeps the border and hides the middle: {}; white must mark the object, so invert the \
             masks unless this is intended: {}",
            inverted.len(),
            name_list(&inverted)
        ));
    }
    Ok(warnings)
}

/// Alpha at the points of a grid, row-major, with the size of the grid.
fn sampled_alpha(image: &PackedImage) -> (Vec<f32>, (usize, usize)) {
    let (width, height) = (image.width as usize, image.height as usize);
    let along = |side: usize| (0..side).step_by(side.div_ceil(GRID).max(1));
    let alpha =
        along(height).flat_map(|y| along(width).map(move |x| image.pixel(y * width + x)[3])).collect();
    (alpha, (along(width).count(), along(height).count()))
}

fn is_inverted(alpha: &[f32], (width, height): (usize, usize)) -> bool {
    let (mut border, mut middle) = ([0.0f64; 2], [0.0f64; 2]);
    for (i, a) in alpha.iter().enumerate() {
        let from_edge = |at: usize, side: usize| (at.min(side - 1 - at) as f64 + 0.5) / side as f64;
        let nearest = from_edge(i % width, width).min(from_edge(i / width, height));
        let sum = match nearest {
            near if near < BORDER => &mut border,
            near if near > 1.0 / 3.0 => &mut middle,
            _ => continue,
        };
        *sum = [sum[0] + f64::from(*a), sum[1] + 1.0];
    }
    let mean = |[sum, count]: [f64; 2]| sum / f64::max(count, 1.0);
    mean(border) > INVERTED.0 && middle[1] > 0.0 && mean(middle) < INVERTED.1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mask_that_keeps_the_border_and_hides_the_middle_is_inverted() {
        let size = (30, 20);
        let disc = |inside: f32, outside: f32| -> Vec<f32> {
            let at = |i: usize| ((i % 30) as f32 / 15.0 - 1.0, (i / 30) as f32 / 10.0 - 1.0);
            (0..600).map(at).map(|(x, y)| if x * x + y * y < 0.4 { inside } else { outside }).collect()
        };
        assert!(is_inverted(&disc(0.0, 1.0), size));
        assert!(!is_inverted(&disc(1.0, 0.0), size), "the control: a mask of the object");
        assert!(!is_inverted(&disc(1.0, 1.0), size), "no mask");
    }
}
