//! Rectangle of a photograph that shows a grey card.

use std::ops::RangeInclusive;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::training::{ConfigError, check_range};

/// Rectangle of a photograph that shows a white or grey surface which receives all of the light.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct GreyCard {
    /// The photograph: its path in the capture, or the end of that path.
    pub photo: String,
    /// Left edge, in pixels of the stored photograph.
    pub x: u32,
    /// Upper edge, in pixels of the stored photograph.
    pub y: u32,
    /// Width in pixels, at least 1.
    pub width: u32,
    /// Height in pixels, at least 1.
    pub height: u32,
    /// Known linear reflectance of the surface, 0.01 to 1; a grey card has 0.18. The albedo of the trained model is then scaled so that
    /// the surface has this reflectance, and its light is divided by the same factor. Without it the level of the light is an assumption.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.01, maximum = 1)]
    pub reflectance: Option<f32>,
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
            Some(Self { photo: photo.to_owned(), x, y, width, height, reflectance: None })
        };
        read().ok_or_else(|| {
            "must be PHOTO:X,Y,WIDTH,HEIGHT in pixels, e.g. IMG_7.jpg:1200,800,90,60".to_owned()
        })
    }
}

impl GreyCard {
    /// # Errors
    /// The field that is out of range.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        for (side, pixels) in [("width", self.width), ("height", self.height)] {
            check_range(&format!("grey_card.{side}"), pixels, 1..=u32::MAX)?;
        }
        let reflectance = self.reflectance.unwrap_or(*Self::REFLECTANCE.end());
        check_range("grey_card.reflectance", reflectance, Self::REFLECTANCE)
    }

    /// Accepted reflectance.
    pub const REFLECTANCE: RangeInclusive<f32> = 0.01..=1.0;

    /// The first column right of the rectangle and the first row below it.
    pub fn end(&self) -> (u32, u32) {
        (self.x.saturating_add(self.width), self.y.saturating_add(self.height))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grey_card_parses_from_text() {
        let read = |text: &str| text.parse::<GreyCard>();
        assert_eq!(
            read("a.png:5,2,2,3").unwrap(),
            GreyCard { photo: "a.png".into(), x: 5, y: 2, width: 2, height: 3, reflectance: None }
        );
        assert_eq!(read("C:/x/a.png: 5, 2, 2, 3").unwrap().photo, "C:/x/a.png");
        for bad in ["a.png", "5,2,2,3", "a.png:5,2,2", "a.png:5,2,2,-3", "a.png:0.1,0.2,0.3,0.4"] {
            assert!(read(bad).unwrap_err().contains("WIDTH"), "{bad}");
        }
    }
}
