//! The colour of a grey card in one of the photographs.

use std::path::Path;

use crate::images::load_image;
use crate::light_rotations::{NO_SUCH_PHOTO, SEVERAL_PHOTOS, is_named};
use crate::types::MeasuredCard;
use crate::{Capture, CaptureError, CaptureFiles, ImportLimits, ImportOptions, Up, patch_camera};
use relume_scene::{ImageRgba, srgb};
use relume_spec::training::GreyCard;

/// Least mean of a channel, linear; below it, noise dominates the colour.
const MIN_CARD_VALUE: f64 = 0.01;
/// Largest mean of a channel, linear; above it, the photograph is clipped.
const MAX_CARD_VALUE: f64 = 0.98;

fn refused(card: &GreyCard, field: &str, reason: impl Into<String>) -> CaptureError {
    CaptureError::at_field(&card.photo, field, reason)
}

/// Mean colour of the rectangle of `photograph`, linear Rec.709, weighted with alpha.
fn colour(card: &GreyCard, photograph: &ImageRgba) -> Result<[f32; 3], CaptureError> {
    check_inside(card, (photograph.width, photograph.height), "grey_card")?;
    let (right, bottom) = card.end();
    let (columns, rows) = (card.x as usize..right as usize, card.y as usize..bottom as usize);
    let (mut sum, mut weight) = ([0.0f64; 3], 0.0f64);
    for row in rows {
        let start = row * photograph.width as usize;
        for [r, g, b, alpha] in &photograph.pixels[start + columns.start..start + columns.end] {
            let linear = [r, g, b].map(|v| f64::from(srgb::decode(*v) * alpha));
            (0..3).for_each(|c| sum[c] += linear[c]);
            weight += f64::from(*alpha);
        }
    }
    let mean = sum.map(|s| s / weight.max(1e-6));
    let shown = mean.map(|v| format!("{v:.3}")).join(", ");
    if mean.iter().any(|v| *v > MAX_CARD_VALUE) {
        let reason =
            format!("its mean, {shown} linear, is clipped: no channel may be above {MAX_CARD_VALUE}");
        return Err(refused(card, "grey_card", reason));
    }
    if !mean.iter().all(|v| *v >= MIN_CARD_VALUE) {
        let reason =
            format!("its mean, {shown} linear, is too dark: no channel may be below {MIN_CARD_VALUE}");
        return Err(refused(card, "grey_card", reason));
    }
    Ok(mean.map(|v| v as f32))
}

/// Refuses a rectangle, the setting `name`, that does not lie within a photograph of `(width, height)` pixels.
pub(super) fn check_inside(
    rectangle: &GreyCard,
    (width, height): (u32, u32),
    name: &str,
) -> Result<(), CaptureError> {
    let (right, bottom) = rectangle.end();
    let refuse = |side: &str, what: String| {
        let reason = format!("the rectangle must lie within the {what}");
        Err(refused(rectangle, &format!("{name}.{side}"), reason))
    };
    if rectangle.width == 0 || right > width {
        return refuse("width", format!("{width} columns"));
    }
    if rectangle.height == 0 || bottom > height {
        return refuse("height", format!("{height} rows"));
    }
    Ok(())
}

impl Capture {
    /// Measures the colour of `card` in the folder or archive at `path`, from which this capture was imported with `up`. The
    /// photograph is read as it is stored: at its own size, with its lens distortion, and without a mask file.
    ///
    /// # Errors
    /// [`CaptureError::Field`] with a name that fits no photograph or several, a rectangle that does not lie within it, or a
    /// mean colour that is clipped or too dark; otherwise as [`crate::import`].
    pub fn measure_grey_card(
        &mut self,
        path: &Path,
        card: &GreyCard,
        up: Up,
        limits: &ImportLimits,
    ) -> Result<(), CaptureError> {
        let views = self.train.iter().chain(&self.test);
        let mut named = views.map(|view| &view.name).filter(|name| is_named(name, &card.photo));
        let photo = named.next().ok_or_else(|| refused(card, "grey_card.photo", NO_SUCH_PHOTO))?;
        if named.next().is_some() {
            return Err(refused(card, "grey_card.photo", SEVERAL_PHOTOS));
        }
        let options = ImportOptions { limits: *limits, ..ImportOptions::default() };
        let (photograph, _) = load_image(&CaptureFiles::open(path, &options.limits)?, photo, &options)?;
        let colour = colour(card, &photograph)?;
        let camera = card.reflectance.map(|_| patch_camera(path, limits, up, card)).transpose()?;
        self.grey_card = Some(MeasuredCard { colour, camera });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_compare::largest_difference;

    const CARD: [f32; 3] = [0.5, 0.4, 0.2];

    /// 8 x 6 pixels of display value 0.1, with a card of linear colour `card` at (5, 2), 2 x 3 pixels.
    fn photograph(card: [f32; 3]) -> ImageRgba {
        let [r, g, b] = card.map(srgb::encode);
        let is_card = |i: u32| (5..7).contains(&(i % 8)) && (2..5).contains(&(i / 8));
        let pixel = |i: u32| if is_card(i) { [r, g, b, 1.0] } else { [0.1, 0.1, 0.1, 1.0] };
        ImageRgba { width: 8, height: 6, pixels: (0..48).map(pixel).collect() }
    }

    fn card(rectangle: [u32; 4]) -> GreyCard {
        let [x, y, width, height] = rectangle;
        GreyCard { photo: "a.png".into(), x, y, width, height, reflectance: None }
    }

    #[test]
    fn card_colour_is_the_linear_mean_of_the_rectangle_only() {
        let mut photograph = photograph(CARD);
        let off = |rectangle: [u32; 4], photograph: &ImageRgba| {
            largest_difference(&colour(&card(rectangle), photograph).unwrap(), &CARD)
        };
        assert!(off([5, 2, 2, 3], &photograph) < 1e-4);
        let control = off([4, 2, 3, 3], &photograph);
        assert!(control.is_finite() && control > 0.1, "the control: a column beside the card, {control}");
        // Pixels that the photograph's own mask hides do not count.
        photograph.pixels[2 * 8 + 4] = [0.0; 4];
        assert!(off([4, 2, 3, 1], &photograph) < 1e-4);
    }

    #[test]
    fn rectangles_outside_and_clipped_colours_are_refused_by_field() {
        let refused = |rectangle: [u32; 4], shown: [f32; 3]| {
            let error = colour(&card(rectangle), &photograph(shown)).unwrap_err();
            error.field().unwrap().to_owned()
        };
        assert_eq!(refused([7, 2, 2, 3], CARD), "grey_card.width");
        assert_eq!(refused([u32::MAX, 2, u32::MAX, 3], CARD), "grey_card.width");
        assert_eq!(refused([5, 4, 2, 3], CARD), "grey_card.height");
        assert_eq!(refused([5, 2, 2, 0], CARD), "grey_card.height");
        for colour in [[0.99, 0.5, 0.5], [0.5, 0.5, 0.005]] {
            assert_eq!(refused([5, 2, 2, 3], colour), "grey_card", "{colour:?}");
        }
        assert!(colour(&card([5, 2, 2, 3]), &photograph([0.97, 0.5, 0.02])).is_ok(), "the control");
    }
}
