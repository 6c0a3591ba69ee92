//! The colour of a grey card in one of the photographs.

use std::path::Path;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::capture::images::load_image;
use crate::capture::light_rotations::{NO_SUCH_PHOTO, SEVERAL_PHOTOS, is_named};
use crate::capture::{Capture, CaptureError, ImportLimits, ImportOptions, Source};
use crate::formats::srgb;
use crate::scene::ImageRgba;

/// Least mean of a channel, linear: below, noise decides the colour.
const DARKEST: f64 = 0.01;
/// Largest mean of a channel, linear: above, the photograph is clipped.
const BRIGHTEST: f64 = 0.98;

/// A rectangle of a photograph that shows something white or grey which all of the light falls on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct GreyCard {
    /// The photograph: its path in the capture, or the end of it.
    pub photo: String,
    /// Left edge, pixels of the stored photograph.
    pub x: u32,
    /// Upper edge, pixels of the stored photograph.
    pub y: u32,
    /// Pixels, at least 1.
    pub width: u32,
    /// Pixels, at least 1.
    pub height: u32,
}

impl GreyCard {
    fn refused(&self, field: &str, reason: impl Into<String>) -> CaptureError {
        CaptureError::at_field(&self.photo, field, reason)
    }

    /// Mean colour of the rectangle of `photograph`, linear Rec.709, weighted with alpha.
    fn colour(&self, photograph: &ImageRgba) -> Result<[f32; 3], CaptureError> {
        let (columns, rows) = (self.x as usize..self.right(), self.y as usize..self.bottom());
        if columns.is_empty() || columns.end > photograph.width as usize {
            let reason = format!("the rectangle must lie within the {} columns", photograph.width);
            return Err(self.refused("grey_card.width", reason));
        }
        if rows.is_empty() || rows.end > photograph.height as usize {
            let reason = format!("the rectangle must lie within the {} rows", photograph.height);
            return Err(self.refused("grey_card.height", reason));
        }
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
        if mean.iter().any(|v| *v > BRIGHTEST) {
            let reason = format!("its mean, {shown} linear, is clipped: no channel may be above {BRIGHTEST}");
            return Err(self.refused("grey_card", reason));
        }
        if !mean.iter().all(|v| *v >= DARKEST) {
            let reason = format!("its mean, {shown} linear, is too dark: no channel may be below {DARKEST}");
            return Err(self.refused("grey_card", reason));
        }
        Ok(mean.map(|v| v as f32))
    }

    fn right(&self) -> usize {
        (self.x as usize).saturating_add(self.width as usize)
    }

    fn bottom(&self) -> usize {
        (self.y as usize).saturating_add(self.height as usize)
    }
}

/// `PHOTO:X,Y,WIDTH,HEIGHT`.
impl FromStr for GreyCard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let read = || {
            let (photo, rectangle) = text.rsplit_once(':')?;
            let numbers: Vec<u32> =
                rectangle.split(',').map(|n| n.trim().parse().ok()).collect::<Option<_>>()?;
            let [x, y, width, height] = numbers[..] else { return None };
            Some(Self { photo: photo.to_owned(), x, y, width, height })
        };
        read().ok_or_else(|| {
            "must be PHOTO:X,Y,WIDTH,HEIGHT in pixels, e.g. IMG_7.jpg:1200,800,90,60".to_owned()
        })
    }
}

impl Capture {
    /// Measures the colour of `card` in the folder or archive at `path`, from which this capture was imported. It is read in
    /// the photograph as stored: at its own size, with its lens, and without a mask that lies beside it.
    ///
    /// # Errors
    /// [`CaptureError::Field`] with a name that fits no photograph or several, a rectangle that does not lie within it, or a
    /// mean colour that is clipped or too dark; otherwise as [`crate::capture::import`].
    pub fn measure_grey_card(
        &mut self,
        path: &Path,
        card: &GreyCard,
        limits: &ImportLimits,
    ) -> Result<(), CaptureError> {
        let views = self.train.iter().chain(&self.test);
        let mut named = views.map(|view| &view.name).filter(|name| is_named(name, &card.photo));
        let photo = named.next().ok_or_else(|| card.refused("grey_card.photo", NO_SUCH_PHOTO))?;
        if named.next().is_some() {
            return Err(card.refused("grey_card.photo", SEVERAL_PHOTOS));
        }
        let options = ImportOptions { limits: *limits, ..ImportOptions::default() };
        let (photograph, _) = load_image(&Source::open(path, &options.limits)?, photo, &options)?;
        self.grey_card = Some(card.colour(&photograph)?);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        GreyCard { photo: "a.png".into(), x, y, width, height }
    }

    #[test]
    fn the_colour_is_the_linear_mean_of_the_rectangle_alone() {
        let mut photograph = photograph(CARD);
        let off = |rectangle: [u32; 4], photograph: &ImageRgba| {
            let colour = card(rectangle).colour(photograph).unwrap();
            (0..3).map(|c| (colour[c] - CARD[c]).abs()).fold(0.0, f32::max)
        };
        assert!(off([5, 2, 2, 3], &photograph) < 1e-4);
        assert!(off([4, 2, 3, 3], &photograph) > 0.1, "the control: a column beside the card");
        // What a mask in the picture hides does not count.
        photograph.pixels[2 * 8 + 4] = [0.0; 4];
        assert!(off([4, 2, 3, 1], &photograph) < 1e-4);
    }

    #[test]
    fn rectangles_outside_and_colours_that_say_nothing_are_refused_by_field() {
        let refused = |rectangle: [u32; 4], colour: [f32; 3]| {
            let error = card(rectangle).colour(&photograph(colour)).unwrap_err();
            error.field().unwrap().to_owned()
        };
        assert_eq!(refused([7, 2, 2, 3], CARD), "grey_card.width");
        assert_eq!(refused([u32::MAX, 2, u32::MAX, 3], CARD), "grey_card.width");
        assert_eq!(refused([5, 4, 2, 3], CARD), "grey_card.height");
        assert_eq!(refused([5, 2, 2, 0], CARD), "grey_card.height");
        for colour in [[0.99, 0.5, 0.5], [0.5, 0.5, 0.005]] {
            assert_eq!(refused([5, 2, 2, 3], colour), "grey_card", "{colour:?}");
        }
        assert!(card([5, 2, 2, 3]).colour(&photograph([0.97, 0.5, 0.02])).is_ok(), "the control");
    }

    #[test]
    fn a_card_is_read_from_text() {
        let read = |text: &str| text.parse::<GreyCard>();
        assert_eq!(read("a.png:5,2,2,3").unwrap(), card([5, 2, 2, 3]));
        assert_eq!(read("C:/x/a.png: 5, 2, 2, 3").unwrap().photo, "C:/x/a.png");
        for bad in ["a.png", "5,2,2,3", "a.png:5,2,2", "a.png:5,2,2,-3", "a.png:0.1,0.2,0.3,0.4"] {
            assert!(read(bad).unwrap_err().contains("WIDTH"), "{bad}");
        }
    }
}
