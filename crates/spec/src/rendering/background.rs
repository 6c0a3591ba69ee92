//! Background of a rendered image.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Background of a rendered image. As text: `transparent`, `environment` or six hexadecimal digits, e.g.
/// `#f4f4f4`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, Default)]
#[serde(try_from = "String", into = "String")]
pub enum Background {
    /// No background. Alpha is the coverage by the model. JPEG, which has no alpha, shows white.
    #[default]
    Transparent,
    /// The environment map, in `rgb`.
    Environment,
    /// A display colour, sRGB.
    Colour([u8; 3]),
}

impl FromStr for Background {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "transparent" => return Ok(Self::Transparent),
            "environment" => return Ok(Self::Environment),
            _ => {}
        }
        let digits = text.strip_prefix('#').unwrap_or(text);
        let is_colour = digits.len() == 6 && digits.bytes().all(|b| b.is_ascii_hexdigit());
        match u32::from_str_radix(digits, 16) {
            Ok(value) if is_colour => {
                let [_, r, g, b] = value.to_be_bytes();
                Ok(Self::Colour([r, g, b]))
            }
            _ => Err("must be transparent, environment or a colour like #f4f4f4".to_owned()),
        }
    }
}

impl TryFrom<String> for Background {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl fmt::Display for Background {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Transparent => f.write_str("transparent"),
            Self::Environment => f.write_str("environment"),
            Self::Colour([r, g, b]) => write!(f, "#{r:02x}{g:02x}{b:02x}"),
        }
    }
}

impl From<Background> for String {
    fn from(background: Background) -> Self {
        background.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backgrounds_round_trip_as_text_and_other_text_is_refused() {
        for background in
            [Background::Transparent, Background::Environment, Background::Colour([1, 171, 255])]
        {
            assert_eq!(background.to_string().parse(), Ok(background));
        }
        assert_eq!("01ABff".parse(), Ok(Background::Colour([1, 171, 255])));
        for wrong in ["", "white", "#12345", "#1234567", "+12345", "#12 456", "#äöü"] {
            assert!(wrong.parse::<Background>().is_err(), "{wrong}");
        }
    }
}
