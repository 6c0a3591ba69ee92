//! How good a model is on held-out views, and what a job may ask of it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// What was measured on held-out views at the end of a training, at its resolution, tier `standard`, on white.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct Figures {
    /// Held-out views that were compared, evenly spaced over those that the capture has; 0 when nothing was.
    pub views: usize,
    /// Held-out views of the capture.
    pub held_out_views: usize,
    /// The physically based branch, under the recovered light.
    #[serde(default)]
    pub novel_view: Similarity,
    /// The radiance branch.
    #[serde(default)]
    pub novel_view_radiance: Similarity,
    /// As `novel_view`, each picture brought to the exposure and white balance of its photograph by one gain per channel.
    #[serde(default)]
    pub novel_view_matched: Similarity,
    /// Why figures are missing.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub note: Option<String>,
    /// What the import and the training warned of, at most 100 lines.
    #[serde(default)]
    pub warnings: Vec<String>,
}

/// Similarity of pictures and photographs; each figure is computed per picture, then averaged.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct Similarity {
    /// Peak signal to noise ratio, dB.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub psnr: Option<f64>,
    /// Structural similarity; of `novel_view` alone, and of pictures of at least 11 pixels a side.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub ssim: Option<f64>,
}

/// The least or most that a job asks of figures, e.g. `{"novel_view.psnr": ">=28"}`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct QualityGate(pub BTreeMap<String, String>);

/// A figure that was not what the job asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct MissedFigure {
    /// Its name, e.g. `novel_view.psnr`.
    pub figure: String,
    /// What was asked for, e.g. `>=28`.
    pub wanted: String,
    /// What was found; absent when it could not be measured.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub found: Option<f64>,
    /// How far that is from the bound.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub missed_by: Option<f64>,
}

/// A figure that a gate may name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Figure {
    /// PSNR of the physically based branch.
    NovelViewPsnr,
    /// SSIM of the physically based branch.
    NovelViewSsim,
    /// PSNR of the radiance branch.
    RadiancePsnr,
    /// PSNR of the physically based branch at each photograph's exposure.
    MatchedPsnr,
}

impl Figure {
    /// Every figure.
    pub const ALL: [Self; 4] =
        [Self::NovelViewPsnr, Self::NovelViewSsim, Self::RadiancePsnr, Self::MatchedPsnr];

    /// Its path in [`Figures`].
    pub fn name(self) -> &'static str {
        match self {
            Self::NovelViewPsnr => "novel_view.psnr",
            Self::NovelViewSsim => "novel_view.ssim",
            Self::RadiancePsnr => "novel_view_radiance.psnr",
            Self::MatchedPsnr => "novel_view_matched.psnr",
        }
    }

    /// True when only a model with materials has it.
    pub fn needs_materials(self) -> bool {
        self != Self::RadiancePsnr
    }

    /// Its value, if it was measured.
    pub fn of(self, figures: &Figures) -> Option<f64> {
        match self {
            Self::NovelViewPsnr => figures.novel_view.psnr,
            Self::NovelViewSsim => figures.novel_view.ssim,
            Self::RadiancePsnr => figures.novel_view_radiance.psnr,
            Self::MatchedPsnr => figures.novel_view_matched.psnr,
        }
    }
}

/// Why an entry of a gate cannot be understood.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GateError {
    /// The entry's name.
    pub name: String,
    /// What is wrong with it.
    pub reason: String,
}

/// One understood entry of a gate.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Condition {
    figure: Figure,
    operator: &'static str,
    bound: f64,
}

/// Longer ones first, since the others begin like them.
const OPERATORS: [&str; 4] = [">=", "<=", ">", "<"];

impl QualityGate {
    /// True when nothing is asked for.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The figures that are asked for.
    ///
    /// # Errors
    /// Names the first entry that cannot be understood.
    pub fn figures(&self) -> Result<Vec<Figure>, GateError> {
        self.0.iter().map(|(name, wanted)| Ok(condition(name, wanted)?.figure)).collect()
    }

    /// The figures that are not what is asked for. One that was not measured is missed.
    pub fn misses(&self, figures: &Figures) -> Vec<MissedFigure> {
        let missed = |(name, wanted): (&String, &String)| {
            let condition = condition(name, wanted).ok();
            let found = condition.and_then(|c| c.figure.of(figures)).filter(|value| value.is_finite());
            let holds = condition.zip(found).is_some_and(|(c, value)| c.holds(value));
            (!holds).then(|| MissedFigure {
                figure: name.clone(),
                wanted: wanted.clone(),
                found,
                missed_by: condition.zip(found).map(|(c, value)| (c.bound - value).abs()),
            })
        };
        self.0.iter().filter_map(missed).collect()
    }
}

impl Condition {
    fn holds(self, value: f64) -> bool {
        match self.operator {
            ">=" => value >= self.bound,
            "<=" => value <= self.bound,
            ">" => value > self.bound,
            _ => value < self.bound,
        }
    }
}

fn condition(name: &str, wanted: &str) -> Result<Condition, GateError> {
    let refused = |reason: String| GateError { name: name.to_owned(), reason };
    let figure = Figure::ALL.into_iter().find(|figure| figure.name() == name).ok_or_else(|| {
        refused(format!("is no figure; there are {}", Figure::ALL.map(Figure::name).join(", ")))
    })?;
    let text = wanted.trim();
    let understood = OPERATORS.into_iter().find_map(|operator| {
        let bound: f64 = text.strip_prefix(operator)?.trim().parse().ok()?;
        bound.is_finite().then_some(Condition { figure, operator, bound })
    });
    understood.ok_or_else(|| {
        refused(format!("must be >=, >, <= or < and a finite number, e.g. \">=28\"; got {wanted:?}"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gate(name: &str, wanted: &str) -> QualityGate {
        QualityGate([(name.to_owned(), wanted.to_owned())].into())
    }

    fn found(psnr: f64) -> Figures {
        Figures { novel_view: Similarity { psnr: Some(psnr), ssim: None }, ..Figures::default() }
    }

    #[test]
    fn every_operator_holds_on_its_side_of_the_bound() {
        let missed = |wanted: &str, psnr| !gate("novel_view.psnr", wanted).misses(&found(psnr)).is_empty();
        for (wanted, below, at, above) in [
            (">=28", true, false, false),
            (">28", true, true, false),
            ("<=28", false, false, true),
            (" < 28.0 ", false, true, true),
        ] {
            let seen = [27.9, 28.0, 28.1].map(|psnr| missed(wanted, psnr));
            assert_eq!(seen, [below, at, above], "{wanted}");
        }
    }

    #[test]
    fn a_miss_says_by_how_much_and_what_was_not_measured_is_one() {
        let missed = gate("novel_view.psnr", ">=28").misses(&found(25.5));
        assert_eq!((missed[0].found, missed[0].missed_by), (Some(25.5), Some(2.5)));
        let missed = gate("novel_view.ssim", ">=0.9").misses(&found(25.5));
        assert_eq!((missed[0].figure.as_str(), missed[0].found), ("novel_view.ssim", None));
        assert!(QualityGate::default().misses(&found(1.0)).is_empty());
    }

    #[test]
    fn what_cannot_be_understood_is_named() {
        for wanted in ["28", "=28", "==28", ">=", ">=x", ">=inf", ">NaN", "<1e999", ">=28 dB", ""] {
            let error = gate("novel_view.psnr", wanted).figures().unwrap_err();
            assert_eq!(error.name, "novel_view.psnr", "{wanted}");
        }
        let error = gate("psnr", ">=28").figures().unwrap_err();
        assert!(error.reason.contains("novel_view.ssim"), "{}", error.reason);
        for figure in Figure::ALL {
            assert_eq!(gate(figure.name(), ">= 2.5e1").figures(), Ok(vec![figure]));
        }
    }
}
