//! The colour chart in a photograph.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::training::{ConfigError, TrainConfig, TrainOverrides, WhiteBalance};

/// When the chart was made: its colours changed in November 2014.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub enum ChartEdition {
    /// November 2014 or later.
    #[default]
    #[serde(rename = "since_november_2014")]
    SinceNovember2014,
    /// Before November 2014.
    #[serde(rename = "before_november_2014")]
    BeforeNovember2014,
}

/// A classic colour chart of 24 patches in a photograph.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ColourChart {
    /// The photograph: its path in the capture, or the end of that path.
    pub photo: String,
    /// Outer corners of the patches in the corners of the chart, `[x, y]` in pixels of the stored photograph, where the corner of its
    /// first pixel is `[0, 0]`: dark skin, then clockwise bluish green, black and white. The four points must be the corners of a convex
    /// quadrilateral. Another order around the chart is recognised by the colours, with a warning.
    pub corners: [[f64; 2]; 4],
    /// When the chart was made.
    #[serde(default)]
    pub edition: ChartEdition,
    /// True: the albedo of the trained model is scaled so that the neutral patches that the model covers have their reflectance, and its
    /// light is divided by the same factor. Without such patches, the model card has the reason.
    #[serde(default = "scaled")]
    pub level: bool,
}

/// Whether the level of albedo is scaled, in files without the field.
fn scaled() -> bool {
    true
}

/// `PHOTO:X1,Y1,X2,Y2,X3,Y3,X4,Y4`.
impl FromStr for ColourChart {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let read = || {
            let (photo, corners) = text.rsplit_once(':')?;
            let numbers: Vec<f64> =
                corners.split(',').map(|n| n.trim().parse().ok()).collect::<Option<_>>()?;
            let (pairs, []) = numbers.as_chunks::<2>() else { return None };
            let corners = pairs.try_into().ok()?;
            Some(Self { photo: photo.to_owned(), corners, edition: ChartEdition::default(), level: true })
        };
        read().ok_or_else(|| {
            "must be PHOTO:X1,Y1,X2,Y2,X3,Y3,X4,Y4 in pixels: the outer corners of the patches dark skin, bluish green, black and white, \
             e.g. IMG_7.jpg:1200,800,1490,810,1480,1010,1190,1000"
                .to_owned()
        })
    }
}

impl ColourChart {
    /// Checks the corners.
    ///
    /// # Errors
    /// The corners, if they are not those of a convex quadrilateral.
    pub fn check(&self) -> Result<(), ConfigError> {
        let refuse = |reason: &str| Err(ConfigError::new("colour_chart.corners", reason));
        if !self.corners.as_flattened().iter().all(|v| v.is_finite() && *v >= 0.0) {
            return refuse("must be finite and not negative");
        }
        let turns: [f64; 4] = std::array::from_fn(|i| {
            let [a, b, c] = [0, 1, 2].map(|step| self.corners[(i + step) % 4]);
            (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
        });
        if turns.iter().all(|turn| *turn > 0.0) || turns.iter().all(|turn| *turn < 0.0) {
            return Ok(());
        }
        refuse(
            "must be the corners of a convex quadrilateral, in their order around the chart: dark skin, bluish green, black, white",
        )
    }
}

impl TrainConfig {
    /// Takes the colour chart of `overrides`. It makes the light of the photographs neutral.
    ///
    /// # Errors
    /// `colour_chart`, with the setting that contradicts it.
    pub(super) fn take_chart(&mut self, overrides: &TrainOverrides) -> Result<(), ConfigError> {
        let Some(chart) = &overrides.colour_chart else { return Ok(()) };
        let contradicts = [
            (overrides.grey_card.is_some(), "grey_card: the neutral patches of the chart replace the card"),
            (overrides.light.is_some(), "light: the chart makes the light of the photographs neutral"),
            (
                overrides.white_balance.is_some_and(|balance| balance != WhiteBalance::NEUTRAL),
                "white_balance other than `neutral`: the chart makes the light of the photographs neutral",
            ),
        ];
        if let Some((_, other)) = contradicts.iter().find(|(is_given, _)| *is_given) {
            return Err(ConfigError::new("colour_chart", format!("must not be combined with {other}")));
        }
        (self.colour_chart, self.white_balance) = (Some(chart.clone()), WhiteBalance::NEUTRAL);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::training::Preset;

    #[test]
    fn colour_chart_parses_from_text_and_json() {
        let chart: ColourChart = "C:/a.jpg: 1,2.5, 7,2,7,6,1,6".parse().unwrap();
        let corners = [[1.0, 2.5], [7.0, 2.0], [7.0, 6.0], [1.0, 6.0]];
        let edition = ChartEdition::SinceNovember2014;
        assert_eq!(chart, ColourChart { photo: "C:/a.jpg".into(), corners, edition, level: true });
        for bad in [
            "a.jpg",
            "1,2,7,2,7,6,1,6",
            "a.jpg:1,2,7,2,7,6,1",
            "a.jpg:1,2,7,2,7,6,1,6,3,3",
            "a.jpg:1,2,7,2,7,6,1,y",
        ] {
            assert!(bad.parse::<ColourChart>().unwrap_err().contains("X4,Y4"), "{bad}");
        }
        let json = serde_json::json!({ "photo": "C:/a.jpg", "corners": corners });
        assert_eq!(serde_json::from_value::<ColourChart>(json.clone()).unwrap(), chart);
        let mut old = json;
        old["edition"] = "before_november_2014".into();
        old["level"] = false.into();
        let old = serde_json::from_value::<ColourChart>(old).unwrap();
        assert_eq!((old.edition, old.level), (ChartEdition::BeforeNovember2014, false));
    }

    fn trained(overrides: &serde_json::Value) -> Result<TrainConfig, String> {
        let overrides: TrainOverrides = serde_json::from_value(overrides.clone()).unwrap();
        TrainConfig::new(Preset::Draft, &overrides).map_err(|error| error.field)
    }

    #[test]
    fn corners_that_are_no_quadrilateral_are_refused() {
        let with = |corners: [[f64; 2]; 4]| {
            trained(&serde_json::json!({ "colour_chart": { "photo": "a", "corners": corners } }))
        };
        let corners = [[1.0, 1.0], [7.0, 1.0], [7.0, 5.0], [1.0, 5.0]];
        let [a, b, c, d] = corners;
        assert!(with(corners).is_ok() && with([d, c, b, a]).is_ok(), "the controls");
        for bad in [[a, c, b, d], [a, a, c, d], [a, b, [2.0, 2.0], d], [[-1.0, 1.0], b, c, d]] {
            assert_eq!(with(bad).unwrap_err(), "colour_chart.corners", "{bad:?}");
        }
    }

    #[test]
    fn settings_that_contradict_a_colour_chart_are_refused() {
        let chart = serde_json::json!({ "photo": "a", "corners": [[1, 1], [7, 1], [7, 5], [1, 5]] });
        let with = |name: &str, value: serde_json::Value| {
            trained(&serde_json::json!({ "colour_chart": chart, name: value }))
        };
        for (name, value) in [
            ("grey_card", serde_json::json!({ "photo": "a", "x": 0, "y": 0, "width": 1, "height": 1 })),
            ("white_balance", "auto".into()),
            ("white_balance", 3200.into()),
            ("light", serde_json::json!({ "environment": "studio" })),
        ] {
            assert_eq!(with(name, value).unwrap_err(), "colour_chart", "{name}");
        }
        let config = with("white_balance", "neutral".into()).unwrap();
        assert_eq!(config.white_balance, WhiteBalance::NEUTRAL);
        assert_eq!(with("seed", 3.into()).unwrap().white_balance, WhiteBalance::NEUTRAL);
    }
}
