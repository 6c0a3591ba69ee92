//! The condition at which a training may stop before all of its steps are done.

use std::fmt::{self, Display, Formatter};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A figure on held-out photographs, named as in the report of an evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UntilFigure {
    /// PSNR of the physically based branch, dB.
    NovelViewPsnr,
    /// SSIM of the physically based branch.
    NovelViewSsim,
}

impl UntilFigure {
    const ALL: [Self; 2] = [Self::NovelViewPsnr, Self::NovelViewSsim];

    /// Name in the report.
    pub fn name(self) -> &'static str {
        match self {
            Self::NovelViewPsnr => "novel_view.psnr",
            Self::NovelViewSsim => "novel_view.ssim",
        }
    }

    /// Largest value: 100 dB, or 1.
    pub fn largest(self) -> f64 {
        match self {
            Self::NovelViewPsnr => 100.0,
            Self::NovelViewSsim => 1.0,
        }
    }
}

/// A least value of a figure, written `novel_view.psnr>=30`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Until {
    /// The figure.
    pub figure: UntilFigure,
    /// Its least value: above 0, at most [`UntilFigure::largest`].
    pub least: f64,
}

impl Until {
    /// Whether a measured value meets the condition. A value that is absent or NaN does not.
    pub fn is_met(self, value: Option<f64>) -> bool {
        value.is_some_and(|value| value >= self.least)
    }
}

impl FromStr for Until {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = |reason: String| format!("{text:?}: {reason}; write for example novel_view.psnr>=30");
        let Some((name, value)) = text.split_once(">=") else {
            return Err(wrong("there is no >= between a figure and a number".to_owned()));
        };
        let (name, value) = (name.trim(), value.trim());
        let Some(figure) = UntilFigure::ALL.into_iter().find(|figure| figure.name() == name) else {
            let names = UntilFigure::ALL.map(UntilFigure::name).join(" nor ");
            return Err(wrong(format!("the figure {name:?} is neither {names}")));
        };
        let least: f64 = value.parse().map_err(|_| wrong(format!("{value:?} is not a number")))?;
        // False for NaN.
        if !(least > 0.0 && least <= figure.largest()) {
            return Err(wrong(format!("the value must be above 0 and at most {}", figure.largest())));
        }
        Ok(Self { figure, least })
    }
}

impl Display for Until {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{}>={}", self.figure.name(), self.least)
    }
}

impl From<Until> for String {
    fn from(until: Until) -> Self {
        until.to_string()
    }
}

impl TryFrom<String> for Until {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_parse_and_are_written_back() {
        let psnr: Until = "novel_view.psnr>=30".parse().unwrap();
        assert_eq!(psnr, Until { figure: UntilFigure::NovelViewPsnr, least: 30.0 });
        assert_eq!(
            " novel_view.ssim >= 0.95 ".parse::<Until>().unwrap().to_string(),
            "novel_view.ssim>=0.95"
        );
        let json = serde_json::to_string(&psnr).unwrap();
        assert_eq!(json, "\"novel_view.psnr>=30\"");
        assert_eq!(serde_json::from_str::<Until>(&json).unwrap(), psnr);
    }

    #[test]
    fn other_conditions_are_refused_with_the_reason() {
        for (text, reason) in [
            ("", "there is no >="),
            ("novel_view.psnr>30", "there is no >="),
            ("novel_view.psnr<=30", "there is no >="),
            ("psnr>=30", "the figure \"psnr\" is neither novel_view.psnr nor novel_view.ssim"),
            ("novel_view.psnr>=", "\"\" is not a number"),
            ("novel_view.psnr>=30 dB", "is not a number"),
            ("novel_view.psnr>=NaN", "above 0 and at most 100"),
            ("novel_view.psnr>=0", "above 0 and at most 100"),
            ("novel_view.ssim>=30", "above 0 and at most 1"),
        ] {
            let error = text.parse::<Until>().unwrap_err();
            assert!(error.contains(reason) && error.contains("for example"), "{text}: {error}");
        }
        let error = serde_json::from_str::<Until>("\"x>=1\"").unwrap_err().to_string();
        assert!(error.contains("novel_view.psnr"), "{error}");
    }

    #[test]
    fn a_value_that_is_absent_or_nan_meets_nothing() {
        let until: Until = "novel_view.psnr>=30".parse().unwrap();
        assert!(until.is_met(Some(30.0)) && !until.is_met(Some(29.9)));
        assert!(!until.is_met(None) && !until.is_met(Some(f64::NAN)));
    }
}
