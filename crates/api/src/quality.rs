//! Quality figures of a model on held-out views, and the bounds that a job sets on them.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Figures measured on held-out views at the end of a training, at the training resolution, in the tier
/// `standard`, on a white background.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Figures {
    /// Number of compared held-out views. They are evenly spaced over the held-out views of the capture. 0 if
    /// nothing was compared.
    pub views: usize,
    /// Number of held-out views of the capture.
    pub held_out_views: usize,
    /// Number of pixels of the object in the compared views: those inside the masks, without masks all. The
    /// figures also count the white background.
    #[serde(default)]
    pub foreground_pixels: u64,
    /// Figures of the physically based branch under the recovered light.
    #[serde(default)]
    pub novel_view: Similarity,
    /// Figures of the radiance branch.
    #[serde(default)]
    pub novel_view_radiance: Similarity,
    /// As `novel_view`, after one gain per channel has matched each image to the exposure and white balance
    /// of its photograph.
    #[serde(default)]
    pub novel_view_matched: Similarity,
    /// Reason for missing figures.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub note: Option<String>,
    /// Warnings of the import and the training, at most 100.
    #[serde(default)]
    pub warnings: Vec<String>,
}

/// Similarity of rendered images to photographs. Each figure is computed per image, then averaged.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Similarity {
    /// Peak signal-to-noise ratio, dB.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub psnr: Option<f64>,
    /// Structural similarity (SSIM). Only in `novel_view`, and only for images of at least 11 pixels per
    /// side.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub ssim: Option<f64>,
}

/// Bounds that a job sets on figures, e.g. `{"novel_view.psnr": ">=28"}`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct QualityGate(pub BTreeMap<String, String>);

/// A figure that misses its bound.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct MissedFigure {
    /// Name of the figure, e.g. `novel_view.psnr`.
    pub figure: String,
    /// Requested bound, e.g. `>=28`.
    pub wanted: String,
    /// Measured value. Absent if it could not be measured.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub found: Option<f64>,
    /// Distance of the measured value from the bound.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub missed_by: Option<f64>,
}

/// A figure that a quality gate can bound.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Figure {
    /// PSNR of the physically based branch.
    NovelViewPsnr,
    /// SSIM of the physically based branch.
    NovelViewSsim,
    /// PSNR of the radiance branch.
    RadiancePsnr,
    /// PSNR of the physically based branch, matched to each photograph's exposure and white
    /// balance.
    MatchedPsnr,
}

impl Figure {
    /// All figures.
    pub const ALL: [Self; 4] =
        [Self::NovelViewPsnr, Self::NovelViewSsim, Self::RadiancePsnr, Self::MatchedPsnr];

    /// Path in [`Figures`].
    pub fn name(self) -> &'static str {
        match self {
            Self::NovelViewPsnr => "novel_view.psnr",
            Self::NovelViewSsim => "novel_view.ssim",
            Self::RadiancePsnr => "novel_view_radiance.psnr",
            Self::MatchedPsnr => "novel_view_matched.psnr",
        }
    }

    /// True if only a model with materials has the figure.
    pub fn needs_materials(self) -> bool {
        self != Self::RadiancePsnr
    }

    /// Measured value, if any.
    pub fn of(self, figures: &Figures) -> Option<f64> {
        match self {
            Self::NovelViewPsnr => figures.novel_view.psnr,
            Self::NovelViewSsim => figures.novel_view.ssim,
            Self::RadiancePsnr => figures.novel_view_radiance.psnr,
            Self::MatchedPsnr => figures.novel_view_matched.psnr,
        }
    }
}

/// Error of an entry of a quality gate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GateError {
    /// Name of the entry.
    pub name: String,
    /// Reason.
    pub reason: String,
}

/// A parsed entry of a quality gate.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Condition {
    figure: Figure,
    operator: &'static str,
    bound: f64,
}

/// Longer operators first, because shorter ones are their prefixes.
const OPERATORS: [&str; 4] = [">=", "<=", ">", "<"];

impl QualityGate {
    /// True if the gate has no bounds.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The bounded figures.
    ///
    /// # Errors
    /// Names the first invalid entry.
    pub fn figures(&self) -> Result<Vec<Figure>, GateError> {
        self.0.iter().map(|(name, wanted)| Ok(condition(name, wanted)?.figure)).collect()
    }

    /// The bounds that `figures` misses. A figure without a measured value misses its bound.
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
        refused(format!("is not a figure; the figures are {}", Figure::ALL.map(Figure::name).join(", ")))
    })?;
    let text = wanted.trim();
    let understood = OPERATORS.into_iter().find_map(|operator| {
        let bound: f64 = text.strip_prefix(operator)?.trim().parse().ok()?;
        bound.is_finite().then_some(Condition { figure, operator, bound })
    });
    understood.ok_or_else(|| {
        refused(format!("must be >=, >, <= or < followed by a finite number, e.g. \">=28\"; got {wanted:?}"))
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
    fn each_comparison_operator_treats_the_bound_correctly() {
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
    fn miss_reports_its_margin_and_unmeasured_figures_fail_the_gate() {
        let missed = gate("novel_view.psnr", ">=28").misses(&found(25.5));
        assert_eq!((missed[0].found, missed[0].missed_by), (Some(25.5), Some(2.5)));
        let missed = gate("novel_view.ssim", ">=0.9").misses(&found(25.5));
        assert_eq!((missed[0].figure.as_str(), missed[0].found), ("novel_view.ssim", None));
        assert!(QualityGate::default().misses(&found(1.0)).is_empty());
    }

    #[test]
    fn unparsable_gates_are_refused_by_figure_name() {
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
