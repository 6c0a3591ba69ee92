//! Three lines on the quality of a model: its scores, its weakest view, and the probable causes.

use serde_json::Value;

use crate::eval::coverage::{ABOVE_DEG, Coverage};
use crate::eval::report::{ImageScores, Report, ViewScore, figure};
use relume_capture::Capture;
use relume_capture::check::PhotographFaults;

/// Difference of PSNR from which a second figure is stated, dB.
const NOTABLE_DB: f64 = 0.3;
/// Difference of PSNR from the radiance branch from which materials and light are weak, dB.
const WEAK_MATERIALS_DB: f64 = 1.0;
/// Range of azimuth without a photograph from which it is a cause, degrees.
const GAP_DEG: f64 = 75.0;
/// Share of photographs from above below which they are few.
const FEW_FROM_ABOVE: f64 = 0.1;
/// Share of the allowed Gaussians from which all count as used.
const ALL_GAUSSIANS: f64 = 0.98;
/// Greatest number of names in a cause.
const NAMES: usize = 3;

/// The facts about a capture that explain scores. They are collected before a training, which then needs the photographs alone.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureFacts {
    faults: PhotographFaults,
    coverage: Coverage,
    held_out: usize,
}

impl CaptureFacts {
    /// Collects the facts. This decodes every training photograph once, reduced to at most 800 pixels.
    pub fn of(capture: &Capture) -> Self {
        let compared = if capture.test.is_empty() { &capture.train } else { &capture.test };
        Self {
            faults: PhotographFaults::of(&capture.train),
            coverage: Coverage::of(capture, compared),
            held_out: capture.test.len(),
        }
    }

    /// Three lines on `report`, whose model has this card: the scores, the weakest view with its direction, and the
    /// probable causes.
    pub fn summary(&self, report: &Report, card: &Value) -> Vec<String> {
        vec![
            self.scores(report),
            format!("weakest: {}", listed(self.weaknesses(report), "no view was compared")),
            format!("causes: {}", listed(self.causes(card), "no fault of the photographs was found")),
        ]
    }

    fn scores(&self, report: &Report) -> String {
        let (photographs, all) = match self.held_out {
            0 => ("no photograph is held out; training photographs", self.faults.photographs),
            held_out => ("held-out photographs", held_out),
        };
        let [raw, matched] = scores_of(report);
        let mut text = format!("{photographs} ({} of {all}): PSNR {} dB", report.views, figure(raw.psnr, 1));
        if let Some((raw, matched)) = raw.psnr.zip(matched.psnr).filter(|(a, b)| b - a >= NOTABLE_DB) {
            let gain = matched - raw;
            text += &format!(" ({matched:.1} dB at the exposure of each photograph, {gain:+.1})");
        }
        text += &format!(", SSIM {}", figure(raw.ssim, 3));
        if raw.lpips.is_some() {
            text += &format!(", LPIPS {}", figure(raw.lpips, 3));
        }
        text
    }

    fn weaknesses(&self, report: &Report) -> Vec<String> {
        let mut found = Vec::new();
        if let Some(ViewScore { view, psnr }) = &report.weakest_view {
            let mut text = format!("{view}, {psnr:.1} dB");
            let direction = self.coverage.direction_of(view).filter(|_| self.coverage.is_around);
            if let Some((elevation, nearest)) = direction {
                let side = if elevation < 0.0 { "below" } else { "above" };
                text += &format!(", {} {side} the horizon", degrees(elevation.abs()));
                let angle = nearest.map(|a| format!(", {} from the nearest training photograph", degrees(a)));
                text.extend(angle);
            }
            found.push(text);
        }
        let (shaded, radiance) = (report.novel_view_matched.psnr, report.novel_view_radiance_matched.psnr);
        if let Some((shaded, radiance)) = shaded.zip(radiance).filter(|(s, r)| r - s >= WEAK_MATERIALS_DB) {
            let below = radiance - shaded;
            found.push(format!("materials and light, {below:.1} dB below the colours without relighting"));
        }
        found
    }

    fn causes(&self, card: &Value) -> Vec<String> {
        let all = self.faults.photographs;
        let mut causes: Vec<String> = exposure_scatter(card).into_iter().collect();
        for (names, what) in [
            (&self.faults.blurred, "blurred"),
            (&self.faults.dark, "dark"),
            (&self.faults.overexposed, "overexposed, or in front of white"),
        ] {
            if !names.is_empty() {
                causes.push(format!("{} of {all} photographs {what} ({})", names.len(), some_of(names)));
            }
        }
        causes.extend(self.gaps());
        if self.faults.are_few {
            causes.push(format!("few photographs ({all}; 40 to 200 are better)"));
        }
        causes.extend(unknown_level(card));
        causes.extend(capacity(card));
        causes
    }

    /// Directions without photographs.
    fn gaps(&self) -> Vec<String> {
        let (all, coverage) = (self.faults.photographs, &self.coverage);
        let mut gaps = Vec::new();
        if !coverage.is_around {
            return gaps;
        }
        let above = coverage.views_from_above();
        if (above as f64) < FEW_FROM_ABOVE * all as f64 {
            gaps.push(format!(
                "few photographs from above ({above} of {all} from {ABOVE_DEG:.0} degrees or higher)"
            ));
        }
        let gap = coverage.azimuth_gap_deg();
        if gap >= GAP_DEG {
            gaps.push(format!("no photograph in {gap:.0} of the 360 degrees around the subject"));
        }
        gaps
    }
}

/// The scores of the branch that the model has, as they are and at the exposure of each photograph.
fn scores_of(report: &Report) -> [ImageScores; 2] {
    match report.novel_view.psnr {
        Some(_) => [report.novel_view, report.novel_view_matched],
        None => [report.novel_view_radiance, report.novel_view_radiance_matched],
    }
}

/// The standard deviation of the exposures, if the training corrected them.
fn exposure_scatter(card: &Value) -> Option<String> {
    let percent = |key: &str| Some(100.0 * card.pointer("/exposures/spread")?.get(key)?.as_f64()?);
    let white_balance = percent("red_over_green")?.max(percent("blue_over_green")?);
    let exposure = percent("green")?;
    Some(format!(
        "exposure scatter {exposure:.0} % and white balance scatter {white_balance:.0} %, corrected"
    ))
}

/// The level of the light, if the surface has one colour without highlights of metal and the light is not known: twice the light on
/// half the albedo gives the same photographs.
fn unknown_level(card: &Value) -> Option<String> {
    let is_one_colour = card.get("prototypes")?.as_u64()? == 1;
    let is_dielectric = card.pointer("/complexity/findings")?.as_array()?.iter().any(|finding| {
        finding["setting"] == "metalness" && finding["is"] == "dielectric" && finding["forced"] == false
    });
    let is_known = card.pointer("/config/light").is_some_and(|light| !light.is_null());
    (is_one_colour && is_dielectric && !is_known).then(|| {
        "the surface has one colour, so the photographs do not determine how bright it is: give the light (--light)".to_owned()
    })
}

/// The limit of the settings on Gaussians, if the training reached it.
fn capacity(card: &Value) -> Option<String> {
    let gaussians = card.get("gaussians")?.as_u64()?;
    let allowed = card.pointer("/config/max_gaussians")?.as_u64()?;
    (gaussians as f64 >= ALL_GAUSSIANS * allowed as f64)
        .then(|| format!("all {allowed} allowed Gaussians are used: a higher preset has more"))
}

/// An angle without decimals.
fn degrees(angle: f64) -> String {
    let rounded = angle.round();
    format!("{rounded:.0} {}", if rounded == 1.0 { "degree" } else { "degrees" })
}

fn some_of(names: &[String]) -> String {
    let shown = names.iter().take(NAMES).map(String::as_str).collect::<Vec<_>>().join(", ");
    if names.len() > NAMES { format!("{shown}, ...") } else { shown }
}

fn listed(parts: Vec<String>, none: &str) -> String {
    if parts.is_empty() { none.to_owned() } else { parts.join("; ") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_capture::{SyntheticOptions, synthetic};
    use serde_json::json;

    fn facts(test_views: usize) -> CaptureFacts {
        let options =
            SyntheticOptions { size: 16, train_views: 12, test_views, paths: 4, ..Default::default() };
        let mut facts = CaptureFacts::of(&synthetic(&options).unwrap());
        (facts.faults.blurred, facts.faults.overexposed) = Default::default();
        facts
    }

    fn report() -> Report {
        let scores = |psnr: f64| ImageScores { psnr: Some(psnr), ssim: Some(0.8), lpips: None };
        Report {
            views: 2,
            weakest_view: Some(ViewScore { view: "test_001/rgba.png".to_owned(), psnr: 19.5 }),
            novel_view: scores(25.0),
            novel_view_matched: scores(26.5),
            novel_view_radiance: scores(26.0),
            novel_view_radiance_matched: scores(27.0),
            ..Report::default()
        }
    }

    #[test]
    fn summary_states_scores_the_weakest_view_and_causes() {
        let mut facts = facts(3);
        facts.faults.blurred = ["a", "b", "c", "d"].map(str::to_owned).into();
        let card = json!({"exposures": {"spread": {"green": 0.08, "red_over_green": 0.01, "blue_over_green": 0.02}}});
        let lines = facts.summary(&report(), &card);
        assert_eq!(
            lines[0],
            "held-out photographs (2 of 3): PSNR 25.0 dB (26.5 dB at the exposure of each photograph, +1.5), SSIM 0.800"
        );
        assert!(lines[1].starts_with("weakest: test_001/rgba.png, 19.5 dB, "), "{}", lines[1]);
        assert_eq!([degrees(0.6), degrees(1.6)], ["1 degree", "2 degrees"]);
        assert!(lines[1].ends_with("degrees from the nearest training photograph"), "{}", lines[1]);
        assert!(lines[2].contains("exposure scatter 8 % and white balance scatter 2 %"), "{}", lines[2]);
        assert!(lines[2].contains("4 of 12 photographs blurred (a, b, c, ...)"), "{}", lines[2]);
        assert!(lines[2].contains("few photographs (12"), "{}", lines[2]);
    }

    #[test]
    fn a_cause_is_stated_only_with_its_evidence() {
        let mut facts = facts(3);
        facts.faults.are_few = false;
        let card =
            |gaussians: u64| json!({"gaussians": gaussians, "config": {"max_gaussians": 800, "seed": 0}});
        let causes = |facts: &CaptureFacts, gaussians| facts.summary(&report(), &card(gaussians))[2].clone();
        assert!(causes(&facts, 799).contains("all 800 allowed Gaussians are used:"));
        assert_eq!(causes(&facts, 400), "causes: no fault of the photographs was found", "the control");
        facts.faults.are_few = true;
        assert_eq!(causes(&facts, 400), "causes: few photographs (12; 40 to 200 are better)");
    }

    #[test]
    fn an_unknown_level_of_the_light_is_stated_for_one_colour() {
        let mut facts = facts(3);
        facts.faults.are_few = false;
        let card = |prototypes: u32, metalness: &str, light: Value| {
            json!({
                "prototypes": prototypes, "config": {"light": light},
                "complexity": {"findings": [{"setting": "metalness", "is": metalness, "forced": false}]},
            })
        };
        let is_stated =
            |card: &Value| facts.summary(&report(), card)[2].contains("do not determine how bright it is");
        assert!(is_stated(&card(1, "dielectric", Value::Null)));
        for other in [
            card(2, "dielectric", Value::Null),
            card(1, "learned", Value::Null),
            card(1, "dielectric", json!({"environment": "studio"})),
        ] {
            assert!(!is_stated(&other), "{other}");
        }
    }

    #[test]
    fn missing_scores_and_held_out_views_are_stated() {
        let mut report = report();
        report.novel_view = ImageScores::default();
        report.novel_view_matched = ImageScores::default();
        report.weakest_view = None;
        let lines = facts(0).summary(&report, &Value::Null);
        let start = "no photograph is held out; training photographs (2 of 12): PSNR 26.0 dB (27.0 dB";
        assert!(lines[0].starts_with(start), "{}", lines[0]);
        assert_eq!(lines[1], "weakest: no view was compared");
        report.novel_view_radiance = ImageScores { lpips: Some(0.125), ..ImageScores::default() };
        assert!(facts(0).summary(&report, &Value::Null)[0].ends_with("PSNR - dB, SSIM -, LPIPS 0.125"));
    }

    #[test]
    fn materials_are_weak_if_the_radiance_branch_is_better() {
        let (facts, mut report) = (facts(3), report());
        let weakest = |report: &Report| facts.summary(report, &Value::Null)[1].clone();
        assert!(!weakest(&report).contains("materials"), "the control: 0.5 dB");
        report.novel_view_radiance_matched.psnr = Some(28.6);
        assert!(weakest(&report).contains("materials and light, 2.1 dB below"), "{}", weakest(&report));
    }
}
