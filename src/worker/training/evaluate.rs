//! Comparing a finished model with the capture's held-out views, a view at a time, so that cancellation is seen and the lease is
//! renewed in between.

use std::ops::ControlFlow;
use std::sync::Arc;

use crate::api::quality::{Figures, Similarity};
use crate::api::work::LeaseStatus;
use crate::capture::{Capture, CaptureView};
use crate::engine::Device;
use crate::eval::{EvalError, NovelViews};
use crate::render::{RenderError, Tier};
use crate::scene::Model;
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
        attempt: &mut Attempt<'_>,
        model: &Arc<Model>,
        capture: Capture,
    ) -> Result<ControlFlow<AttemptEnd, Figures>, AttemptError> {
        let claim = attempt.claim;
        let held_out_views = capture.test.len();
        let mut comparison = Comparison::new(capture, attempt.trainer.config().light_rotations);
        if comparison.count == 0 {
            attempt.tell(NO_VIEWS).await;
        }
        while let Some(view) = comparison.waiting.next() {
            if self.stop.is_cancelled() {
                return attempt.suspend().await.map(ControlFlow::Break);
            }
            let number = comparison.compared + 1;
            let message = format!("comparing held-out view {number} of {}", comparison.count);
            let update = attempt.reporter.after_training(attempt.trainer.progress(), message);
            if held_or_unknown(claim.progress(&update).await) != LeaseStatus::Held {
                return Ok(ControlFlow::Break(settle(claim).await?));
            }
            comparison.compare(&view, model, self.device_of(claim)?).map_err(failed)?;
        }
        Ok(ControlFlow::Continue(comparison.figures(held_out_views)))
    }
}

/// A comparison in progress.
struct Comparison {
    waiting: std::vec::IntoIter<CaptureView>,
    count: usize,
    compared: usize,
    /// There once a view was compared.
    views: Option<NovelViews>,
}

impl Comparison {
    fn new(capture: Capture, with_turns: bool) -> Self {
        let views = capture.test;
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
        Self { waiting: waiting.into_iter(), count, compared: 0, views: None }
    }

    fn compare(&mut self, view: &CaptureView, model: &Arc<Model>, device: &Device) -> Result<(), EvalError> {
        let views = match &mut self.views {
            Some(views) => views,
            none => none.insert(NovelViews::new(model.clone(), Tier::Standard.into(), device)?),
        };
        views.compare(view)?;
        self.compared += 1;
        Ok(())
    }

    /// The means over all views that were compared.
    fn figures(&self, held_out_views: usize) -> Figures {
        let scores = self.views.as_ref().map(NovelViews::scores);
        let note = scores.map_or(Some(NO_VIEWS), |scores| {
            let absent = scores.shaded.psnr.is_none();
            absent.then_some("the model was trained for colour alone: only the radiance branch was compared")
        });
        let scores = scores.unwrap_or_default();
        let psnr = |psnr| Similarity { psnr, ssim: None };
        Figures {
            views: self.compared,
            held_out_views,
            novel_view: Similarity { psnr: scores.shaded.psnr, ssim: scores.shaded.ssim },
            novel_view_radiance: psnr(scores.radiance.psnr),
            novel_view_matched: psnr(scores.matched.psnr),
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
        let taken: Vec<CaptureView> = Comparison::new(capture.clone(), true).waiting.collect();
        let expected = [0, 2, 5, 7, 10, 12, 15, 17].map(|i: usize| names[i].clone());
        assert_eq!(taken.iter().map(|view| view.name.clone()).collect::<Vec<_>>(), expected);
        assert!(taken.iter().all(|view| view.light_rotation_deg == 30.0));
        let still = Comparison::new(capture, false).waiting.next().unwrap();
        assert_eq!(still.light_rotation_deg, 0.0, "as if the light had stood still");
    }

    #[test]
    fn without_held_out_views_there_are_no_figures_and_a_note_says_why() {
        let comparison = Comparison::new(capture(0), true);
        assert_eq!(comparison.waiting.len(), 0);
        let figures = comparison.figures(0);
        assert_eq!(figures, Figures { note: Some(NO_VIEWS.to_owned()), ..Figures::default() });
    }
}
