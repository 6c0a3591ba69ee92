//! The report of an evaluation: JSON with stable keys, and a Markdown table of the same values.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

/// Similarity of two sets of images. Each value is computed per image, then averaged.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct ImageScores {
    /// Peak signal-to-noise ratio, dB.
    pub psnr: Option<f64>,
    /// Structural similarity.
    pub ssim: Option<f64>,
    /// LPIPS v0.1, AlexNet.
    pub lpips: Option<f64>,
}

/// Relit scores by light name, and their mean over lights.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct RelitScores {
    /// Mean over lights.
    pub mean: ImageScores,
    /// One entry per light.
    #[serde(flatten)]
    pub lights: BTreeMap<String, ImageScores>,
}

/// Errors of the albedo, linear.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct AlbedoScores {
    /// PSNR without alignment, whole image on white, dB.
    pub psnr_raw: Option<f64>,
    /// PSNR after the per-channel median alignment, whole image on white, dB.
    pub psnr_aligned: Option<f64>,
    /// As `psnr_raw`, over foreground pixels only.
    pub psnr_raw_foreground: Option<f64>,
    /// As `psnr_aligned`, over foreground pixels only.
    pub psnr_aligned_foreground: Option<f64>,
    /// The alignment: per-channel median of ground truth / prediction.
    pub scale: Option<[f32; 3]>,
}

/// Mean angular error of normals, degrees.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct NormalScores {
    /// Inside the ground-truth mask.
    pub foreground: Option<f64>,
    /// TensoIR's mean over all pixels, including empty ones.
    pub all_pixels: Option<f64>,
}

/// The score of one view.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ViewScore {
    /// The name of the photograph.
    pub view: String,
    /// PSNR at the exposure and white balance of the photograph, dB: of the physically based branch; of the radiance
    /// branch for a model without materials.
    pub psnr: f64,
}

/// All measurements of `relume eval`. A value that could not be measured is null, and `notes` states the reason.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Description of the comparison: sizes, window, masks, curve.
    pub protocol: String,
    /// Number of compared test views. A view whose mask is empty is not compared.
    pub views: usize,
    /// Number of pixels of the object in the photographs of these views: those inside the masks, without masks all.
    #[serde(default)]
    pub foreground_pixels: u64,
    /// Share of these pixels among all pixels, 0 to 1. The image scores also count the white background.
    #[serde(default)]
    pub foreground_share: Option<f64>,
    /// PSNR of `novel_view` over the pixels of the object alone, dB.
    #[serde(default)]
    pub novel_view_foreground_psnr: Option<f64>,
    /// Held-out views, physically based branch under the recovered light.
    pub novel_view: ImageScores,
    /// Held-out views, radiance branch.
    pub novel_view_radiance: ImageScores,
    /// As `novel_view`, with each image matched to the exposure and white balance of its photograph by one gain per
    /// channel.
    #[serde(default)]
    pub novel_view_matched: ImageScores,
    /// As `novel_view_radiance`, with the same matching.
    #[serde(default)]
    pub novel_view_radiance_matched: ImageScores,
    /// The compared view with the lowest PSNR.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weakest_view: Option<ViewScore>,
    /// Scores, weaknesses and their probable causes, a sentence each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub summary: Vec<String>,
    /// Held-out views under lights without photographs, with the recovered albedo.
    pub relit: RelitScores,
    /// As `relit`, after the albedo alignment.
    pub relit_aligned: RelitScores,
    /// Errors of the base colour.
    pub albedo: AlbedoScores,
    /// Errors of the shading normals.
    pub normal_mae_deg: NormalScores,
    /// Mean absolute error of ambient occlusion, foreground.
    pub ao_mae: Option<f64>,
    /// Mean absolute error of roughness, foreground.
    pub roughness_mae: Option<f64>,
    /// Mean absolute error of metalness, foreground.
    pub metallic_mae: Option<f64>,
    /// Mean absolute error of depth, capture units, foreground.
    pub depth_mae: Option<f64>,
    /// Training time from the model card, seconds.
    pub training_seconds: Option<f64>,
    /// Number of Gaussians in the model.
    pub gaussians: usize,
    /// Relit frames per second by tier, at the size of the test views, with prepared tables.
    pub render_fps: BTreeMap<String, f64>,
    /// Reasons for null values, by key.
    pub notes: BTreeMap<String, String>,
}

impl Report {
    /// Keeps the score of a view if it is the lowest so far. A score that is not a number is not kept.
    pub(super) fn note_view(&mut self, view: &str, psnr: f64) {
        let lowest = self.weakest_view.as_ref().map_or(f64::INFINITY, |weakest| weakest.psnr);
        if psnr < lowest {
            self.weakest_view = Some(ViewScore { view: view.to_owned(), psnr });
        }
    }

    /// Adds a training time that the caller knows, e.g. from a job, if the model card has none.
    pub fn note_training_seconds(&mut self, seconds: Option<f64>) {
        if self.training_seconds.is_none() && seconds.is_some() {
            self.training_seconds = seconds;
            self.notes.remove("training_seconds");
        }
    }

    /// The report as indented JSON with a final newline.
    pub fn to_json(&self) -> String {
        // The report has only numbers and strings, so serialisation cannot fail.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// The report as Markdown: a table of image scores, a table of single values, then protocol and notes.
    pub fn to_markdown(&self) -> String {
        let mut out = String::from("| images | PSNR dB | SSIM | LPIPS |\n|---|---|---|---|\n");
        let mut row = |name: &str, s: &ImageScores| {
            let cells = [figure(s.psnr, 2), figure(s.ssim, 4), figure(s.lpips, 4)].join(" | ");
            let _ = writeln!(out, "| {} | {cells} |", cell(name));
        };
        row("novel view", &self.novel_view);
        row("novel view, radiance branch", &self.novel_view_radiance);
        row("novel view, exposure matched", &self.novel_view_matched);
        row("novel view, radiance branch, exposure matched", &self.novel_view_radiance_matched);
        for (title, scores) in [("relit", &self.relit), ("relit, albedo aligned", &self.relit_aligned)] {
            row(&format!("{title}, mean"), &scores.mean);
            scores.lights.iter().for_each(|(light, s)| row(&format!("{title}, {light}"), s));
        }
        out.push_str("\n| measurement | value |\n|---|---|\n");
        for (name, value) in self.figures() {
            let _ = writeln!(out, "| {name} | {value} |");
        }
        if !self.summary.is_empty() {
            out.push('\n');
            self.summary.iter().for_each(|line| out.push_str(&format!("- {line}\n")));
        }
        let _ = writeln!(out, "\nProtocol: {}", self.protocol);
        for (key, reason) in &self.notes {
            let _ = writeln!(out, "- `{key}`: {reason}");
        }
        out
    }

    fn figures(&self) -> Vec<(String, String)> {
        let mut rows = vec![
            ("albedo PSNR, raw (dB)", figure(self.albedo.psnr_raw, 2)),
            ("albedo PSNR, median-aligned (dB)", figure(self.albedo.psnr_aligned, 2)),
            ("albedo PSNR, raw, foreground (dB)", figure(self.albedo.psnr_raw_foreground, 2)),
            ("albedo PSNR, median-aligned, foreground (dB)", figure(self.albedo.psnr_aligned_foreground, 2)),
            ("normal MAE, foreground (deg)", figure(self.normal_mae_deg.foreground, 2)),
            ("normal MAE, all pixels (deg)", figure(self.normal_mae_deg.all_pixels, 2)),
            ("ambient occlusion MAE", figure(self.ao_mae, 4)),
            ("roughness MAE", figure(self.roughness_mae, 4)),
            ("metalness MAE", figure(self.metallic_mae, 4)),
            ("depth MAE (capture units)", figure(self.depth_mae, 4)),
            ("training time (s)", figure(self.training_seconds, 0)),
            ("Gaussians", self.gaussians.to_string()),
            ("test views", self.views.to_string()),
            ("pixels of the object in the test views", self.foreground_pixels.to_string()),
            ("share of these among all pixels", figure(self.foreground_share, 3)),
            ("novel view PSNR, foreground (dB)", figure(self.novel_view_foreground_psnr, 2)),
        ];
        rows.retain(|(_, value)| !value.is_empty());
        let rows = rows.into_iter().map(|(name, value)| (name.to_owned(), value));
        let fps =
            self.render_fps.iter().map(|(t, v)| (format!("frames per second, {t}"), figure(Some(*v), 1)));
        rows.chain(fps).collect()
    }
}

/// A number for a table with `digits` decimals, or a dash.
pub fn figure(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |v| format!("{v:.digits$}"))
}

/// A name with the characters escaped that would end its table cell.
fn cell(name: &str) -> String {
    name.replace('|', "\\|").replace('\n', " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_has_stable_keys_and_null_for_missing_values() {
        let mut report = Report::default();
        report.relit.lights.insert("city".into(), ImageScores { psnr: Some(27.5), ..Default::default() });
        report.render_fps.insert("standard".into(), 5.0);
        let json: serde_json::Value = serde_json::from_str(&report.to_json()).unwrap();
        assert_eq!(json["relit"]["city"]["psnr"], 27.5);
        let pointers = [
            "/novel_view/psnr",
            "/novel_view/ssim",
            "/novel_view/lpips",
            "/relit/mean/psnr",
            "/relit/city/lpips",
            "/albedo/psnr_raw",
            "/albedo/psnr_aligned",
            "/normal_mae_deg/foreground",
            "/normal_mae_deg/all_pixels",
            "/ao_mae",
            "/training_seconds",
        ];
        for pointer in pointers {
            assert!(json.pointer(pointer).is_some(), "{pointer} is missing");
        }
        assert!(json["novel_view"]["lpips"].is_null() && json["ao_mae"].is_null());
        assert_eq!(json["render_fps"]["standard"], 5.0);
        assert!(json["protocol"].is_string() && json["gaussians"] == 0);
    }

    #[test]
    fn report_round_trips_through_json() {
        let mut report = Report { ao_mae: Some(0.125), ..Default::default() };
        report.relit.lights.insert("night".into(), ImageScores { ssim: Some(0.5), ..Default::default() });
        assert_eq!(serde_json::from_str::<Report>(&report.to_json()).unwrap(), report);
    }

    #[test]
    fn lowest_score_is_kept_and_nan_is_not() {
        let mut report = Report::default();
        for (view, psnr) in [("a", 20.0), ("b", f64::NAN), ("c", 18.0), ("d", 19.0)] {
            report.note_view(view, psnr);
        }
        assert_eq!(report.weakest_view, Some(ViewScore { view: "c".to_owned(), psnr: 18.0 }));
        assert!(report.to_json().contains("weakest_view") && !report.to_json().contains("summary"));
        report.summary.push("weakest: c".to_owned());
        assert!(report.to_markdown().contains("\n- weakest: c\n\nProtocol"), "{}", report.to_markdown());
        assert_eq!(serde_json::from_str::<Report>(&report.to_json()).unwrap(), report);
    }

    #[test]
    fn markdown_shows_a_dash_for_missing_values_and_escapes_pipes() {
        let mut report = Report::default();
        report.novel_view.psnr = Some(31.234);
        report.relit.lights.insert("a|b".into(), ImageScores::default());
        let text = report.to_markdown();
        assert!(text.contains("| novel view | 31.23 | - | - |"), "{text}");
        assert!(text.contains("| relit, a\\|b | - | - | - |"), "{text}");
    }
}
