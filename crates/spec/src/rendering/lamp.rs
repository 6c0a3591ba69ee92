//! Lamps: lights at a place, beside the environment map.

use std::f64::consts::PI;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::rendering::Colour;
use relume_scene::light::{LightColour, luminance};
use relume_scene::srgb;

/// Largest number of lamps of a picture.
pub const MAX_LAMPS: usize = 16;
/// Range of colour temperatures, kelvin.
const KELVIN: std::ops::RangeInclusive<f32> = 1_700.0..=20_000.0;
/// Full angle of the cone of a spot without one, degrees.
const CONE_DEG: f64 = 45.0;
/// Greatest coordinate and size, units of the capture.
const MAX_LENGTH: f64 = 1e6;
/// Greatest intensity.
const MAX_INTENSITY: f64 = 1e12;

/// Shape of a lamp.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LampShape {
    /// Shines in all directions: a bulb of `radius`.
    #[default]
    Point,
    /// A bulb of `radius` whose light is limited to a cone towards `target`.
    Spot,
    /// A flat disc of `radius` that faces `target`.
    Disc,
    /// A flat rectangle of `size` that faces `target`: a soft box or a window.
    Rectangle,
}

impl LampShape {
    /// All shapes.
    pub const ALL: [Self; 4] = [Self::Point, Self::Spot, Self::Disc, Self::Rectangle];

    /// Name in requests.
    pub fn name(self) -> &'static str {
        match self {
            Self::Point => "point",
            Self::Spot => "spot",
            Self::Disc => "disc",
            Self::Rectangle => "rectangle",
        }
    }
}

/// A lamp. Exactly one of `intensity`, `candela` and `lumen` is required.
///
/// As text: the shape, then `KEY=VALUE` separated by spaces, e.g. `spot position=2,1,2 target=0,0,0 intensity=20 kelvin=3200`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Lamp {
    /// Shape: `point`, `spot`, `disc` or `rectangle`.
    pub shape: LampShape,
    /// Position, capture units.
    pub position: [f64; 3],
    /// Point that the lamp faces, capture units. Required except for `point`, which has none.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub target: Option<[f64; 3]>,
    /// Radius of the bulb or disc, capture units. Omitted: 0, which casts sharp shadows. Not for `rectangle`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 0)]
    pub radius: Option<f64>,
    /// Width and height of a `rectangle`, capture units. Its width is horizontal.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub size: Option<[f64; 2]>,
    /// Full angle of the cone of a `spot`, 1 to 179 degrees. The outer fifth of the half angle is a soft edge. Omitted: 45.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 1, maximum = 179)]
    pub cone_deg: Option<f64>,
    /// Colour temperature, 1,700 to 20,000 kelvin. Omitted: `colour`, or white.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 1700, maximum = 20000)]
    pub kelvin: Option<f32>,
    /// Colour, sRGB, such as `#ffcc88`. It does not change the luminance. Not together with `kelvin`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>, pattern = "^#?[0-9a-fA-F]{6}$", example = "#ffcc88")]
    pub colour: Option<Colour>,
    /// Radiant intensity along the axis: the irradiance of a surface that faces the lamp at a distance of 1 capture unit, in the units
    /// of the environment map. A white wall that gets the irradiance 3.14 is as bright as a map of radiance 1.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 0)]
    pub intensity: Option<f64>,
    /// Luminous intensity along the axis, candela. The value 1 in the map counts as 1 cd/m^2.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 0)]
    pub candela: Option<f64>,
    /// Luminous flux of the whole lamp, lumen. The value 1 in the map counts as 1 cd/m^2.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 0)]
    pub lumen: Option<f64>,
    /// Length of a capture unit in metres, for `candela` and `lumen`. Omitted: 1.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub metres_per_unit: Option<f64>,
}

impl Lamp {
    /// The first invalid field and the reason; `None` for a valid lamp.
    pub fn fault(&self) -> Option<(&'static str, String)> {
        self.fault_of_place().or_else(|| self.fault_of_light())
    }

    fn fault_of_place(&self) -> Option<(&'static str, String)> {
        let place = format!("must be three numbers from -{MAX_LENGTH} to {MAX_LENGTH}");
        let is_far = |p: &[f64; 3]| p.iter().any(|v| v.is_nan() || v.abs() > MAX_LENGTH);
        let is_length = |v: f64| (0.0..=MAX_LENGTH).contains(&v);
        let name = self.shape.name();
        match (self.shape, self.target) {
            _ if is_far(&self.position) => return Some(("position", place)),
            (LampShape::Point, Some(_)) => {
                return Some((
                    "target",
                    "does not apply to a point, which shines in all directions".to_owned(),
                ));
            }
            (LampShape::Point, None) => {}
            (_, None) => return Some(("target", format!("is required: a {name} faces a point"))),
            (_, Some(target)) if is_far(&target) => return Some(("target", place)),
            (_, Some(target)) if target == self.position => {
                return Some(("target", "must not be the position".to_owned()));
            }
            _ => {}
        }
        if self.radius.is_some_and(|radius| !is_length(radius)) {
            return Some(("radius", format!("must be 0 to {MAX_LENGTH}")));
        }
        match (self.shape, self.radius, self.size) {
            (LampShape::Rectangle, Some(_), _) => {
                return Some(("radius", "does not apply to a rectangle, which has a size".to_owned()));
            }
            (LampShape::Rectangle, _, None) => {
                return Some(("size", "is required: width and height of the rectangle".to_owned()));
            }
            (LampShape::Rectangle, _, Some(size)) if !size.iter().all(|v| is_length(*v) && *v > 0.0) => {
                return Some(("size", format!("must be two numbers above 0, at most {MAX_LENGTH}")));
            }
            (LampShape::Point | LampShape::Spot | LampShape::Disc, _, Some(_)) => {
                return Some(("size", format!("applies to a rectangle; a {name} has a radius")));
            }
            _ => {}
        }
        match self.cone_deg {
            Some(_) if self.shape != LampShape::Spot => Some(("cone_deg", "applies to a spot".to_owned())),
            Some(cone) if !(1.0..=179.0).contains(&cone) => {
                Some(("cone_deg", "must be 1 to 179 degrees".to_owned()))
            }
            _ => None,
        }
    }

    fn fault_of_light(&self) -> Option<(&'static str, String)> {
        let strengths = [("intensity", self.intensity), ("candela", self.candela), ("lumen", self.lumen)];
        let given: Vec<_> =
            strengths.into_iter().filter_map(|(field, value)| Some((field, value?))).collect();
        match given.as_slice() {
            [] => return Some(("intensity", "is required, or candela or lumen".to_owned())),
            [(field, value)] if !(0.0..=MAX_INTENSITY).contains(value) => {
                return Some((field, format!("must be 0 to {MAX_INTENSITY}")));
            }
            [_] => {}
            [_, (field, _), ..] => return Some((field, format!("must not be combined with {}", given[0].0))),
        }
        match (self.metres_per_unit, self.intensity) {
            (Some(_), Some(_)) => {
                return Some(("metres_per_unit", "applies to candela and lumen".to_owned()));
            }
            (Some(metres), _) if !(1e-6..=1e6).contains(&metres) => {
                return Some(("metres_per_unit", "must be 0.000001 to 1000000".to_owned()));
            }
            _ => {}
        }
        match (self.kelvin, self.colour) {
            (Some(_), Some(_)) => Some(("colour", "must not be combined with kelvin".to_owned())),
            (Some(kelvin), _) if !KELVIN.contains(&kelvin) => {
                Some(("kelvin", "must be 1700 to 20000".to_owned()))
            }
            (_, Some(Colour([0, 0, 0]))) => {
                Some(("colour", "must not be black; set intensity to 0".to_owned()))
            }
            _ => None,
        }
    }

    /// The lamp with `gain` times its intensity.
    #[must_use]
    pub fn scaled(&self, gain: f64) -> Self {
        let [intensity, candela, lumen] =
            [self.intensity, self.candela, self.lumen].map(|v| v.map(|v| v * gain));
        Self { intensity, candela, lumen, ..self.clone() }
    }

    /// Half angle of the cone of a spot, radians.
    pub fn half_cone(&self) -> f64 {
        0.5 * self.cone_deg.unwrap_or(CONE_DEG).to_radians()
    }

    /// Radiant intensity along the axis, linear Rec.709, map units times capture units squared.
    pub fn radiant_intensity(&self) -> [f64; 3] {
        let metres = self.metres_per_unit.unwrap_or(1.0);
        let candela = self.candela.or_else(|| Some(self.lumen? / self.effective_solid_angle()));
        let strength = self.intensity.or_else(|| Some(candela? / (metres * metres))).unwrap_or(0.0);
        let colour = match (self.kelvin, self.colour) {
            (Some(kelvin), _) => LightColour::black_body(kelvin).rgb(),
            (None, Some(Colour(bytes))) => bytes.map(|v| srgb::decode(f32::from(v) / 255.0)),
            (None, None) => [1.0; 3],
        };
        let level = f64::from(luminance(colour)).max(1e-9);
        colour.map(|v| strength * f64::from(v) / level)
    }

    /// Flux of a lamp whose intensity along its axis is 1, steradian.
    fn effective_solid_angle(&self) -> f64 {
        match self.shape {
            LampShape::Point => 4.0 * PI,
            LampShape::Spot => 2.0 * PI * (1.0 - (0.9 * self.half_cone()).cos()),
            LampShape::Disc | LampShape::Rectangle => PI,
        }
    }
}

impl FromStr for Lamp {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = "write for instance \"spot position=2,1,2 target=0,0,0 intensity=20 kelvin=3200\"";
        let mut words = text.split_whitespace();
        let name = words.next().unwrap_or_default();
        let shape = LampShape::ALL.into_iter().find(|shape| shape.name() == name);
        let shape =
            shape.ok_or_else(|| format!("must begin with point, spot, disc or rectangle; {wanted}"))?;
        let mut lamp = Self { shape, ..Self::default() };
        let mut has_position = false;
        for word in words {
            let (key, value) = word.split_once('=').ok_or_else(|| format!("{word:?}: {wanted}"))?;
            let bad = |what: &str| format!("{key}={value}: must be {what}");
            let number = || value.parse::<f64>().map(Some).map_err(|_| bad("a number"));
            match key {
                "position" => {
                    lamp.position = numbers(value).ok_or_else(|| bad("three numbers such as 2,1,2"))?;
                    has_position = true;
                }
                "target" => {
                    lamp.target = Some(numbers(value).ok_or_else(|| bad("three numbers such as 0,0,0"))?)
                }
                "size" => lamp.size = Some(numbers(value).ok_or_else(|| bad("two numbers such as 1,0.5"))?),
                "radius" => lamp.radius = number()?,
                "cone" => lamp.cone_deg = number()?,
                "kelvin" => lamp.kelvin = Some(value.parse().map_err(|_| bad("a number"))?),
                "colour" | "color" => lamp.colour = Some(value.parse()?),
                "intensity" => lamp.intensity = number()?,
                "candela" => lamp.candela = number()?,
                "lumen" => lamp.lumen = number()?,
                "metres" => lamp.metres_per_unit = number()?,
                _ => {
                    return Err(format!(
                        "{key}: unknown; the keys are position, target, radius, size, cone, kelvin, colour, intensity, candela, lumen and metres"
                    ));
                }
            }
        }
        if !has_position {
            return Err(format!("position is required; {wanted}"));
        }
        match lamp.fault() {
            // The keys of the text are shorter than two of the fields.
            Some(("cone_deg", reason)) => Err(format!("cone: {reason}")),
            Some(("metres_per_unit", reason)) => Err(format!("metres: {reason}")),
            Some((field, reason)) => Err(format!("{field}: {reason}")),
            None => Ok(lamp),
        }
    }
}

/// `N` numbers, separated by commas.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let values: Option<Vec<f64>> = text.split(',').map(|v| v.parse().ok()).collect();
    values?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Lamp, String> {
        text.parse()
    }

    #[test]
    fn lamps_are_read_from_text() {
        let lamp =
            read("spot position=2,1,2 target=0,0,0.5 radius=0.1 cone=30 kelvin=3200 intensity=20").unwrap();
        let expected = Lamp {
            shape: LampShape::Spot,
            position: [2.0, 1.0, 2.0],
            target: Some([0.0, 0.0, 0.5]),
            radius: Some(0.1),
            cone_deg: Some(30.0),
            kelvin: Some(3200.0),
            intensity: Some(20.0),
            ..Lamp::default()
        };
        assert_eq!(lamp, expected);
        assert_eq!(serde_json::from_value::<Lamp>(serde_json::to_value(&lamp).unwrap()).unwrap(), lamp);
        assert!(
            read("rectangle position=0,0,2 target=0,0,0 size=1,0.5 lumen=800 metres=0.1 colour=#ffcc88")
                .is_ok()
        );
    }

    #[test]
    fn wrong_lamps_are_refused_by_field() {
        for (text, named) in [
            ("", "point, spot"),
            ("sun position=0,0,1 intensity=1", "point, spot"),
            ("point intensity=1", "position"),
            ("point position=0,0 intensity=1", "position=0,0"),
            ("point position=0,0,nan intensity=1", "position"),
            ("point position=0,0,1", "intensity: is required"),
            ("point position=0,0,1 intensity=-1", "intensity"),
            ("point position=0,0,1 intensity=inf", "intensity"),
            ("point position=0,0,1 intensity=1 lumen=3", "lumen"),
            ("point position=0,0,1 intensity=1 metres=2", "metres: applies"),
            ("point position=0,0,1 target=0,0,0 intensity=1", "target"),
            ("spot position=0,0,1 intensity=1", "target"),
            ("spot position=0,0,1 target=0,0,1 intensity=1", "target"),
            ("spot position=0,0,1 target=0,0,0 cone=180 intensity=1", "cone"),
            ("disc position=0,0,1 target=0,0,0 cone=30 intensity=1", "cone"),
            ("rectangle position=0,0,1 target=0,0,0 intensity=1", "size"),
            ("rectangle position=0,0,1 target=0,0,0 size=1,0 intensity=1", "size"),
            ("disc position=0,0,1 target=0,0,0 size=1,1 intensity=1", "size"),
            ("point position=0,0,1 radius=-1 intensity=1", "radius"),
            ("point position=0,0,1 kelvin=10 intensity=1", "kelvin"),
            ("point position=0,0,1 kelvin=3000 colour=#ffffff intensity=1", "colour"),
            ("point position=0,0,1 colour=#000000 intensity=1", "colour"),
            ("point position=0,0,1 brightness=1", "brightness"),
            ("point position", "position"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(named), "{text}: {error}");
        }
    }

    #[test]
    fn intensity_has_the_luminance_of_its_unit() {
        let level = |text: &str| {
            let [r, g, b] = read(text).unwrap().radiant_intensity();
            f64::from(luminance([r as f32, g as f32, b as f32]))
        };
        let near = |text: &str, expected: f64| {
            assert!((level(text) / expected - 1.0).abs() < 1e-4, "{text}: {}", level(text))
        };
        near("point position=0,0,1 intensity=5 kelvin=2700", 5.0);
        near("point position=0,0,1 candela=5 colour=#4080ff", 5.0);
        near("point position=0,0,1 candela=5 metres=0.1", 500.0);
        near("point position=0,0,1 lumen=1256.637", 100.0);
        near("disc position=0,0,1 target=0,0,0 radius=1 lumen=314.1593", 100.0);
        let warm = read("point position=0,0,1 intensity=1 kelvin=2700").unwrap().radiant_intensity();
        assert!(warm[0] > warm[1] && warm[1] > warm[2], "{warm:?}");
    }
}
