//! Comparing a finished model with the capture's held-out views, a view at a time, so that frames are served, cancellation is
//! seen and the lease is renewed in between.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Duration;

use crate::api::quality::{Figures, Similarity};
use crate::capture::{Capture, CaptureView};
use crate::engine::Device;
use crate::eval::{EvalError, EvalOptions, Report, evaluate};
use crate::render::{RenderError, Tier};
use crate::scene::Model;
use crate::store::LeaseStatus;
use crate::train::TrainError;
use crate::worker::thread::Worker;
use crate::worker::training::outcome::{AttemptEnd, AttemptError, settle};
use crate::worker::training::{Attempt, held_or_unknown};

/// Most views that are compared.
const MOST_VIEWS: usize = 8;
/// What is said of a capture without any.
const NO_VIEWS: &str = "the capture has no held-out views: nothing was compared";

impl Worker {
    /// What the model of a finished training is found to be.
    pub(super) async fn measure(
        &mut self,
        attempt: &Attempt<'_>,
        model: &Arc<Model>,
        capture: Capture,
    ) -> Result<ControlFlow<AttemptEnd, Figures>, AttemptError> {
        let lease = attempt.lease;
        let held_out_views = capture.test.len();
        let mut comparison = Comparison::new(capture, attempt.trainer.config().light_rotations);
        if comparison.count == 0 {
            attempt.tell(NO_VIEWS).await;
        }
        while let Some(number) = comparison.next() {
            if self.stop.is_cancelled() {
                return attempt.suspend().await.map(ControlFlow::Break);
            }
            let message = format!("comparing held-out view {number} of {}", comparison.count);
            let update = attempt.reporter.after_training(attempt.trainer.progress(), message);
            if held_or_unknown(lease.progress(&update).await) != LeaseStatus::Held {
                return Ok(ControlFlow::Break(settle(lease).await?));
            }
            comparison.compare(model, self.device_of(lease)?)?;
            self.serve_waiting();
        }
        let mut figures = comparison.figures(held_out_views);
        figures.warnings = lease.jobs().store().warnings(&lease.job().id).await?;
        Ok(ControlFlow::Continue(figures))
    }
}

/// A comparison in progress.
struct Comparison {
    /// The capture, with the view that is compared as its only held-out one.
    capture: Capture,
    waiting: std::vec::IntoIter<CaptureView>,
    count: usize,
    reports: Vec<Report>,
}

impl Comparison {
    fn new(mut capture: Capture, with_turns: bool) -> Self {
        let views = std::mem::take(&mut capture.test);
        let (all, count) = (views.len(), views.len().min(MOST_VIEWS));
        let is_chosen = |i: usize| (0..count).any(|k| k * all / count == i);
        let chosen = views.into_iter().enumerate().filter(|(i, _)| is_chosen(*i));
        let as_trained = |(_, mut view): (usize, CaptureView)| {
            if !with_turns {
                view.light_rotation_deg = 0.0;
            }
            view
        };
        let waiting: Vec<CaptureView> = chosen.map(as_trained).collect();
        Self { capture, waiting: waiting.into_iter(), count, reports: Vec::new() }
    }

    /// Takes the next view; its number, from 1.
    fn next(&mut self) -> Option<usize> {
        self.capture.test = vec![self.waiting.next()?];
        Some(self.reports.len() + 1)
    }

    /// Compares the view that was taken.
    fn compare(&mut self, model: &Arc<Model>, device: &Device) -> Result<(), AttemptError> {
        let options = EvalOptions {
            quality: Tier::Standard.into(),
            frame_rate_time: Duration::ZERO,
            device,
            ..EvalOptions::default()
        };
        self.reports.push(evaluate(model.clone(), &self.capture, &options).map_err(failed)?);
        Ok(())
    }

    /// The means over all views that were compared.
    fn figures(&self, held_out_views: usize) -> Figures {
        let mean = |pick: fn(&Report) -> Option<f64>| {
            let values: Vec<f64> = self.reports.iter().filter_map(pick).collect();
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        let psnr = |pick| Similarity { psnr: mean(pick), ssim: None };
        let note = self.reports.first().map_or(Some(NO_VIEWS), |report| {
            let absent = report.novel_view.psnr.is_none();
            absent.then_some("the model was trained for colour alone: only the radiance branch was compared")
        });
        Figures {
            views: self.reports.len(),
            held_out_views,
            novel_view: Similarity { psnr: mean(|r| r.novel_view.psnr), ssim: mean(|r| r.novel_view.ssim) },
            novel_view_radiance: psnr(|r| r.novel_view_radiance.psnr),
            novel_view_matched: psnr(|r| r.novel_view_matched.psnr),
            note: note.map(str::to_owned),
            warnings: Vec::new(),
        }
    }
}

/// A device that failed is opened anew and the job goes on from its checkpoint; whatever else fails would fail again.
fn failed(error: EvalError) -> AttemptError {
    match error {
        EvalError::Device(error) | EvalError::Render { source: RenderError::Device(error), .. } => {
            TrainError::Device(error).into()
        }
        error => AttemptError::new("evaluation_failed", error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::{SyntheticOptions, synthetic};

    fn capture(test_views: usize) -> Capture {
        let options =
            SyntheticOptions { size: 16, train_views: 3, test_views, paths: 4, ..Default::default() };
        synthetic(&options).unwrap()
    }

    #[test]
    fn at_most_eight_views_are_compared_evenly_spaced_and_as_they_were_trained() {
        let mut capture = capture(20);
        capture.test.iter_mut().for_each(|view| view.light_rotation_deg = 30.0);
        let names: Vec<String> = capture.test.iter().map(|view| view.name.clone()).collect();
        let mut comparison = Comparison::new(capture.clone(), true);
        let mut taken = Vec::new();
        while comparison.next().is_some() {
            assert_eq!(comparison.capture.test[0].light_rotation_deg, 30.0);
            taken.push(comparison.capture.test[0].name.clone());
        }
        assert_eq!(taken, [0, 2, 5, 7, 10, 12, 15, 17].map(|i: usize| names[i].clone()));
        let mut comparison = Comparison::new(capture, false);
        comparison.next();
        assert_eq!(comparison.capture.test[0].light_rotation_deg, 0.0, "as if the light had stood still");
    }

    #[test]
    fn without_held_out_views_there_are_no_figures_and_a_note_says_why() {
        let mut comparison = Comparison::new(capture(0), true);
        assert_eq!(comparison.next(), None);
        let figures = comparison.figures(0);
        assert_eq!(figures, Figures { note: Some(NO_VIEWS.to_owned()), ..Figures::default() });
    }
}
