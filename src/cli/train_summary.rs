//! The end of `relume train`: scores of the model in three lines, and its contact sheet. A failure here is a warning: the
//! model is written already.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use crate::cli::error::CommandResult;
use crate::cli::progress::ProgressReporter;
use crate::cli::sheet::write_sheet;
use relume_capture::{Capture, CaptureView, ColourMatrix, ImportLimits, Up};
use relume_engine::Device;
use relume_scene::Model;
use relume_spec::training::TrainConfig;
use relume_train::eval::{
    CaptureFacts, EvalError, EvalOptions, Lpips, Report, SheetRows, contact_sheet, evaluate, evenly_spaced,
};

/// Greatest number of compared views, as in the evaluation of a job.
pub(super) const MAX_VIEWS: usize = 8;
/// Time to read the photographs of a whole sheet again, relative to those of one row.
const READ_AGAIN: f64 = 1.5;
/// Photographs whose comparison is timed before the end.
const REHEARSED_VIEWS: usize = 3;

/// The parts of a capture that are needed after the training: at most eight photographs.
pub(super) struct TrainedCapture {
    facts: CaptureFacts,
    /// The compared views: held-out ones in `test`, or else training views in `train`.
    compared: Capture,
    path: PathBuf,
    up: Up,
}

/// Files for the end of a training.
#[derive(Clone, Copy)]
pub(super) struct SummaryFiles<'a> {
    /// The contact sheet to write, if any.
    pub(super) sheet: Option<&'a Path>,
    /// Weights of LPIPS, if it is to be measured.
    pub(super) lpips: Option<&'a Path>,
    /// The model, which the sheet names.
    pub(super) model: &'a Path,
}

impl TrainedCapture {
    /// Keeps the parts of `capture`, which was imported from `path` for a training with `config`. The pixels of the kept views are
    /// shared.
    pub(super) fn of(capture: &Capture, path: &Path, config: &TrainConfig) -> Self {
        let kept = |views: &[CaptureView]| -> Vec<CaptureView> {
            let as_trained = |view: &CaptureView| CaptureView {
                light_rotation_deg: if config.light_rotations { view.light_rotation_deg } else { 0.0 },
                ..view.clone()
            };
            evenly_spaced(views, Some(MAX_VIEWS)).into_iter().map(as_trained).collect()
        };
        let (train, test) = match capture.test.is_empty() {
            true => (kept(&capture.train), Vec::new()),
            false => (Vec::new(), kept(&capture.test)),
        };
        let compared = Capture {
            layout: capture.layout.clone(),
            train,
            test,
            points: Vec::new(),
            bounds: capture.bounds,
            up: capture.up.clone(),
            turntable: None,
            has_alpha: capture.has_alpha,
            lights: capture.lights.clone(),
            measured_light: None,
            grey_card: None,
            colour_chart: capture.colour_chart.clone(),
            warnings: Vec::new(),
        };
        Self {
            facts: CaptureFacts::of(capture),
            compared,
            path: path.to_owned(),
            up: Up::direction(capture.up.direction).unwrap_or_default(),
        }
    }

    /// Compares `model` with the photographs, writes the sheet, and returns three lines for the user. Reports what fails as
    /// warnings; without a comparison there are no lines.
    pub(super) fn summarise(
        mut self,
        model: &Arc<Model>,
        device: &Device,
        files: SummaryFiles<'_>,
        progress: &ProgressReporter,
    ) -> Vec<String> {
        let report = match self.compare(model, device, files.lpips, progress) {
            Ok(report) => report,
            Err(error) => {
                progress.warning(&format!("the model was not compared with photographs: {error}"));
                return Vec::new();
            }
        };
        let lines = self.facts.summary(&report, &model.card);
        if let Some(file) = files.sheet {
            match self.draw(model, device, (&report, &lines), files.model, file, progress) {
                Ok(()) => progress.status(&format!("wrote the contact sheet {}", file.display())),
                Err(error) => progress.warning(&format!("no contact sheet: {error}")),
            }
        }
        lines
    }

    /// The matrix of the photographs.
    fn colours(&self) -> Option<ColourMatrix> {
        self.compared.colour_chart.as_ref().map(|chart| chart.matrix)
    }

    /// Number of photographs that [`Self::summarise`] compares.
    pub(super) fn compared(&self) -> usize {
        self.compared.test.len().max(self.compared.train.len())
    }

    /// Seconds that [`Self::summarise`] will take without LPIPS, from a few photographs and one row of the sheet; `now` returns
    /// the time. `None` if they cannot be compared.
    pub(super) fn rehearse(
        &mut self,
        model: &Arc<Model>,
        device: &Device,
        has_sheet: bool,
        now: &dyn Fn() -> f64,
    ) -> Option<f64> {
        let (start, all) = (now(), self.compared());
        let report = self.evaluate(model, device, None, Some(1)).ok()?;
        let mut seconds = now() - start;
        if all > 1 {
            // The comparison of one photograph includes the preparation of the light.
            let more = REHEARSED_VIEWS.min(all);
            let start = now();
            self.evaluate(model, device, None, Some(more)).ok()?;
            let each = (now() - start - seconds).max(0.0) / (more - 1) as f64;
            seconds += each * (all - 1) as f64;
        }
        if has_sheet {
            let start = now();
            let mut rows = SheetRows::choose(&self.compared, Some(&report));
            let count = rows.count().max(1) as f64;
            rows.truncate(1);
            rows.read_again(&self.path, self.up, self.colours(), &ImportLimits::default()).ok()?;
            let read = now();
            contact_sheet(model.clone(), &rows, EvalOptions::TIER, device).ok()?;
            // Most of the reading is to open the capture.
            seconds += READ_AGAIN * (read - start) + (now() - read) * count;
        }
        Some(seconds)
    }

    fn compare(
        &mut self,
        model: &Arc<Model>,
        device: &Device,
        lpips: Option<&Path>,
        progress: &ProgressReporter,
    ) -> Result<Report, EvalError> {
        let lpips = lpips.and_then(|file| match Lpips::read(file) {
            Ok(lpips) => Some(lpips),
            Err(error) => {
                progress.warning(&format!("LPIPS is not measured: {error}"));
                None
            }
        });
        self.evaluate(model, device, lpips.as_ref(), None)
    }

    /// Compares `model` with `views` of the photographs, or all of them.
    fn evaluate(
        &mut self,
        model: &Arc<Model>,
        device: &Device,
        lpips: Option<&Lpips>,
        views: Option<usize>,
    ) -> Result<Report, EvalError> {
        let options =
            EvalOptions { lpips, views, frame_rate_time: Duration::ZERO, device, ..EvalOptions::default() };
        let _span = tracing::info_span!("compare").entered();
        let is_held_out = !self.compared.test.is_empty();
        let swap = |capture: &mut Capture| {
            if !is_held_out {
                std::mem::swap(&mut capture.train, &mut capture.test);
            }
        };
        swap(&mut self.compared);
        let report = evaluate(model.clone(), &self.compared, &options);
        swap(&mut self.compared);
        report
    }

    fn draw(
        &self,
        model: &Arc<Model>,
        device: &Device,
        (report, lines): (&Report, &[String]),
        model_file: &Path,
        file: &Path,
        progress: &ProgressReporter,
    ) -> CommandResult {
        let _span = tracing::info_span!("contact_sheet").entered();
        let mut rows = SheetRows::choose(&self.compared, Some(report));
        if let Err(error) = rows.read_again(&self.path, self.up, self.colours(), &ImportLimits::default()) {
            progress.warning(&format!("the contact sheet shows photographs as small as trained: {error}"));
        }
        let mut sheet = contact_sheet(model.clone(), &rows, EvalOptions::TIER, device)?;
        sheet.add_heading(format!("{}: {} Gaussians", model_file.display(), model.gaussians.len()));
        lines.iter().for_each(|line| sheet.add_heading(line));
        write_sheet(file, &sheet)
    }
}
