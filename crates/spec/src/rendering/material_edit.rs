//! Changes of single materials of a model.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::rendering::Background;

/// Range of the factor of an albedo.
const SCALE: std::ops::RangeInclusive<f32> = 0.0..=100.0;
/// Range of roughness and metalness.
const UNIT: std::ops::RangeInclusive<f32> = 0.0..=1.0;
/// Largest number of changes in a request.
pub const MAX_MATERIAL_EDITS: usize = 1000;

/// A change of one material. Omitted fields leave the material as it is. An item with `into` or `split` has no other change. These
/// items count before all others, in their order.
///
/// As text, one field each: `3=#224488` (mean albedo, sRGB), `3*=1.2` (factor of the albedo), `3.roughness=0.4`, `3.metalness=1`,
/// `3.into=0`, `3.split=X:Y:Z:RADIUS`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MaterialEdit {
    /// Number of the material, from 0.
    pub material: u32,
    /// Mean albedo, a colour in sRGB such as `#224488`. Differences within the material stay, as factors.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>, pattern = "^#?[0-9a-fA-F]{6}$", example = "#224488")]
    pub colour: Option<Colour>,
    /// Factor of the albedo, 0 to 100, after `colour`. Pictures limit the albedo to 1.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 0.0, maximum = 100.0)]
    pub scale: Option<f32>,
    /// Roughness, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub roughness: Option<f32>,
    /// Metalness, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub metalness: Option<f32>,
    /// Number of another material. The material becomes a part of it: its surface keeps its colours, and changes of the other material
    /// apply to both.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub into: Option<u32>,
    /// A ball. The surface of the material inside it becomes a new material with the next free number.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub split: Option<Ball>,
}

/// A ball in the world of the capture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Ball {
    /// Centre, capture units.
    pub centre: [f64; 3],
    /// Radius, capture units, more than 0.
    pub radius: f64,
}

impl Ball {
    fn is_valid(&self) -> bool {
        self.radius > 0.0 && self.radius.is_finite() && self.centre.iter().all(|v| v.is_finite())
    }

    /// `X:Y:Z:RADIUS`.
    fn of(text: &str) -> Option<Self> {
        let numbers: Vec<f64> = text.split(':').map(str::parse).collect::<Result<_, _>>().ok()?;
        let [x, y, z, radius] = numbers[..] else { return None };
        Some(Self { centre: [x, y, z], radius })
    }
}

impl MaterialEdit {
    /// Whether it merges or splits materials.
    pub fn is_regrouping(&self) -> bool {
        self.into.is_some() || self.split.is_some()
    }

    /// The first field out of its range, and the reason; `None` if all are valid.
    pub fn fault(&self) -> Option<(&'static str, &'static str)> {
        let outside = |value: Option<f32>, range: &std::ops::RangeInclusive<f32>| {
            value.is_some_and(|value| !range.contains(&value))
        };
        if outside(self.scale, &SCALE) {
            return Some(("scale", "must be 0 to 100"));
        }
        let is_change =
            self.colour.is_some() || self.scale.is_some() || self.roughness.or(self.metalness).is_some();
        match (self.into, self.split) {
            (Some(_), None) if is_change => return Some(("into", "must be an item without other changes")),
            (_, Some(_)) if is_change || self.into.is_some() => {
                return Some(("split", "must be an item without other changes"));
            }
            (Some(into), _) if into == self.material => return Some(("into", "must be another material")),
            (_, Some(ball)) if !ball.is_valid() => {
                return Some(("split", "must have finite numbers and a radius more than 0"));
            }
            _ => {}
        }
        let units = [("roughness", self.roughness), ("metalness", self.metalness)];
        units
            .into_iter()
            .find(|(_, value)| outside(*value, &UNIT))
            .map(|(field, _)| (field, "must be 0 to 1"))
    }
}

impl FromStr for MaterialEdit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = || {
            format!(
                "{text:?} is not a change of a material; write for instance 3=#224488 (colour), 3*=1.2 (factor of the albedo), \
                 3.roughness=0.4, 3.metalness=1, 3.into=0 (merge) or 3.split=0.5:0:1:0.2 (split off a ball: x:y:z:radius)"
            )
        };
        let (name, value) = text.split_once('=').ok_or_else(wanted)?;
        let digits = name.len() - name.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        let material = name[..digits].parse().map_err(|_| wanted())?;
        let number = || value.parse::<f32>().map(Some).map_err(|_| wanted());
        let edit = Self { material, ..Self::default() };
        let edit = match &name[digits..] {
            "" => Self { colour: Some(value.parse()?), ..edit },
            "*" => Self { scale: number()?, ..edit },
            ".roughness" => Self { roughness: number()?, ..edit },
            ".metalness" => Self { metalness: number()?, ..edit },
            ".into" => Self { into: Some(value.parse().map_err(|_| wanted())?), ..edit },
            ".split" => Self { split: Some(Ball::of(value).ok_or_else(wanted)?), ..edit },
            _ => return Err(wanted()),
        };
        match edit.fault() {
            None => Ok(edit),
            Some((_, reason)) => Err(format!("{text}: the value {reason}")),
        }
    }
}

/// A display colour, sRGB. As text six hexadecimal digits, with or without `#`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Colour(pub [u8; 3]);

impl FromStr for Colour {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse() {
            Ok(Background::Colour(colour)) => Ok(Self(colour)),
            _ => Err(format!("{text:?} is not a colour like #224488")),
        }
    }
}

impl TryFrom<String> for Colour {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl fmt::Display for Colour {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Background::Colour(self.0).fmt(f)
    }
}

impl From<Colour> for String {
    fn from(colour: Colour) -> Self {
        colour.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_of_materials_are_read_and_others_refused() {
        let base = MaterialEdit { material: 3, ..MaterialEdit::default() };
        for (text, edit) in [
            ("3=#224488", MaterialEdit { colour: Some(Colour([0x22, 0x44, 0x88])), ..base }),
            ("3=224488", MaterialEdit { colour: Some(Colour([0x22, 0x44, 0x88])), ..base }),
            ("3*=1.5", MaterialEdit { scale: Some(1.5), ..base }),
            ("3.roughness=0.25", MaterialEdit { roughness: Some(0.25), ..base }),
            ("3.metalness=1", MaterialEdit { metalness: Some(1.0), ..base }),
            ("3.into=0", MaterialEdit { into: Some(0), ..base }),
            (
                "3.split=1:-0.5:2e-1:0.3",
                MaterialEdit { split: Some(Ball { centre: [1.0, -0.5, 0.2], radius: 0.3 }), ..base },
            ),
        ] {
            assert_eq!(text.parse(), Ok(edit), "{text}");
        }
        for wrong in [
            "",
            "3",
            "=#224488",
            "x=#224488",
            "3=red",
            "3=transparent",
            "3*=-1",
            "3*=NaN",
            "3*=inf",
            "3.gloss=1",
            "3.roughness=1.1",
            "3.metalness=",
            "3.into=3",
            "3.into=-1",
            "3.split=1:2:3",
            "3.split=1:2:3:0",
            "3.split=1:2:NaN:1",
            "3.split=1:2:3:4:5",
            "99999999999=#224488",
            "-1=#224488",
            "ä=#224488",
        ] {
            assert!(wrong.parse::<MaterialEdit>().is_err(), "{wrong}");
        }
        let json = r##"{"material":3,"colour":"#224488","scale":2.0}"##;
        let edit: MaterialEdit = serde_json::from_str(json).expect("valid");
        assert_eq!(serde_json::to_string(&edit).expect("finite"), json);
        assert!(serde_json::from_str::<MaterialEdit>(r#"{"material":3,"color":"x"}"#).is_err());
        let both: MaterialEdit =
            serde_json::from_str(r#"{"material":3,"into":1,"roughness":0.5}"#).expect("the fields exist");
        assert_eq!(both.fault().map(|(field, _)| field), Some("into"));
    }
}
