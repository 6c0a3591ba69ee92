//! Compares a finished model with the capture's held-out views, one view at a time, so that a cancellation is handled and the
//! lease is renewed in between.

use std::ops::ControlFlow;
use std::sync::Arc;

use crate::worker::thread::Worker;
use crate::worker::training::comparison::{Comparison, NO_VIEWS};
use crate::worker::training::outcome::{AttemptEnd, AttemptError, stop_attempt};
use crate::worker::training::{TrainingAttempt, held_or_unknown};
use relume_api::quality::Figures;
use relume_api::work::{LeaseStatus, Release};
use relume_scene::Model;
use relume_train::TrainError;
use relume_train::eval::EvalError;
use relume_train::render::RenderError;

impl Worker {
    /// Measures the accuracy of a finished model.
    pub(super) async fn measure(
        &mut self,
        attempt: &mut TrainingAttempt<'_>,
        model: &Arc<Model>,
        mut comparison: Comparison,
    ) -> Result<ControlFlow<AttemptEnd, Figures>, AttemptError> {
        let claim = attempt.claim;
        if comparison.count == 0 {
            attempt.record_warning(NO_VIEWS).await;
        }
        while let Some(view) = comparison.waiting.next() {
            if self.stop.is_cancelled() {
                return attempt.suspend(Release::Shutdown).await.map(ControlFlow::Break);
            }
            let number = comparison.compared + 1;
            let message = format!("comparing held-out view {number} of {}", comparison.count);
            let update = attempt.reporter.after_training(attempt.trainer.progress(), message);
            if held_or_unknown(claim.progress(&update).await) != LeaseStatus::Held {
                return Ok(ControlFlow::Break(stop_attempt(claim).await?));
            }
            comparison.compare(&view, model, self.device_of(claim)?).map_err(failed)?;
        }
        Ok(ControlFlow::Continue(comparison.figures()))
    }
}

/// After a device failure the job can continue from its checkpoint; any other failure would occur again.
fn failed(error: EvalError) -> AttemptError {
    match error {
        EvalError::Device(error) | EvalError::Render { source: RenderError::Device(error), .. } => {
            TrainError::Device(error).into()
        }
        error => AttemptError::new("evaluation_failed", error.to_string()),
    }
}
