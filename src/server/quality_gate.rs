//! Checks that the figures of a job's quality gate can be measured.

use crate::server::problem::Problem;
use relume_api::quality::QualityGate;
use relume_spec::CaptureReport;
use relume_spec::training::TrainConfig;

/// # Errors
/// Names the entry that is not a figure, is invalid, or cannot be measured on this capture with these settings.
pub(super) fn check(
    gate: &QualityGate,
    capture: &CaptureReport,
    config: &TrainConfig,
) -> Result<(), Problem> {
    let at = |name: &str| format!("/quality_gate/{}", name.replace('~', "~0").replace('/', "~1"));
    let figures = gate.figures().map_err(|error| Problem::invalid_field(at(&error.name), error.reason))?;
    if !gate.is_empty() && capture.test_images == 0 {
        let detail = "the capture has no held-out views, so nothing can be measured";
        return Err(Problem::invalid_field("/quality_gate", detail));
    }
    match figures.into_iter().find(|figure| config.warm_up >= 1.0 && figure.needs_materials()) {
        Some(figure) => Err(Problem::invalid_field(
            at(figure.name()),
            "cannot be measured: with these settings the model has no materials",
        )),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_spec::training::Preset;

    fn refused(gate: &str, held_out: usize, warm_up: f32) -> Option<String> {
        let gate: QualityGate = serde_json::from_str(gate).unwrap();
        let capture = CaptureReport { test_images: held_out, ..CaptureReport::default() };
        let config = TrainConfig { warm_up, ..TrainConfig::preset(Preset::Draft) };
        check(&gate, &capture, &config).err().map(|problem| problem.errors[0].pointer.clone())
    }

    #[test]
    fn gate_on_an_unavailable_metric_is_refused_with_a_pointer() {
        let good = r#"{"novel_view.psnr": ">=28", "novel_view.ssim": "> 0.9"}"#;
        assert_eq!(refused(good, 1, 0.25), None);
        assert_eq!(refused(good, 0, 0.25).as_deref(), Some("/quality_gate"));
        assert_eq!(refused("{}", 0, 0.25), None, "an empty gate");
        assert_eq!(refused(good, 1, 1.0).as_deref(), Some("/quality_gate/novel_view.psnr"));
        assert_eq!(refused(r#"{"novel_view_radiance.psnr": ">20"}"#, 1, 1.0), None);
        assert_eq!(refused(r#"{"a/b": ">=28"}"#, 1, 0.25).as_deref(), Some("/quality_gate/a~1b"));
        let odd = r#"{"novel_view.ssim": "0.9"}"#;
        assert_eq!(refused(odd, 1, 0.25).as_deref(), Some("/quality_gate/novel_view.ssim"));
    }
}
