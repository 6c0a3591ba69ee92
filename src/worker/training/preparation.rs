//! Prepares a trainer from a capture and the job's last checkpoint.

use std::ops::ControlFlow;
use std::sync::Arc;

use tokio_util::bytes::Bytes;

use crate::worker::job_source::{Claim, JobSourceError};
use crate::worker::progress::announce;
use crate::worker::thread::Worker;
use crate::worker::training::outcome::{AttemptEnd, AttemptError};
use relume_capture::{Capture, Up};
use relume_spec::training::TrainConfig;
use relume_train::{PreparedTraining, TrainError, Trainer, up_of_checkpoint};

/// The bytes of a job's last checkpoint, or why it cannot be read; `None` if there is none.
pub(super) type Checkpoint = Option<Result<Bytes, JobSourceError>>;

/// Reads the last checkpoint of a job.
///
/// # Errors
/// If it cannot be read at present.
pub(super) async fn last_checkpoint(claim: &dyn Claim) -> Result<Checkpoint, AttemptError> {
    if claim.task().checkpoint_step.is_none() {
        return Ok(None);
    }
    match claim.last_checkpoint().await {
        // The checkpoint exists and will be available again.
        Err(error @ JobSourceError::Unreachable(_)) => Err(error.into()),
        read => Ok(Some(read)),
    }
}

/// The up direction of the training that the checkpoint continues; `None` without a readable checkpoint.
pub(super) fn world_of(checkpoint: &Checkpoint) -> Option<Up> {
    up_of_checkpoint(checkpoint.as_ref()?.as_ref().ok()?).ok()
}

impl Worker {
    /// Continues from the last checkpoint, or starts from step 0 if it cannot be read.
    pub(super) async fn trainer(
        &mut self,
        claim: &dyn Claim,
        capture: &Arc<Capture>,
        config: TrainConfig,
        checkpoint: Checkpoint,
    ) -> Result<ControlFlow<AttemptEnd, Trainer>, AttemptError> {
        announce(claim, "preparing").await?;
        let capture = capture.clone();
        let (preparation, lost) =
            match self.run_in_background(claim, move || prepare(&capture, config, checkpoint)).await? {
                ControlFlow::Continue(prepared) => prepared?,
                ControlFlow::Break(ending) => return Ok(ControlFlow::Break(ending)),
            };
        if let Some(error) = lost {
            tracing::warn!(%error, "cannot use the checkpoint");
            claim.warn("the last checkpoint cannot be read; the training restarts from step 0").await?;
        }
        Ok(ControlFlow::Continue(preparation.on(self.device_of(claim)?)?))
    }
}

/// The trainer, and the reason why it does not start from the given checkpoint, if it does not.
fn prepare(
    capture: &Capture,
    config: TrainConfig,
    checkpoint: Checkpoint,
) -> Result<(PreparedTraining, Option<TrainError>), TrainError> {
    let Some(checkpoint) = checkpoint else { return Ok((PreparedTraining::new(capture, config)?, None)) };
    let bytes = checkpoint.map_err(|error| TrainError::Checkpoint(error.to_string()));
    match bytes.and_then(|bytes| PreparedTraining::resume(capture, config.clone(), &bytes)) {
        Ok(preparation) => Ok((preparation, None)),
        Err(error) => Ok((PreparedTraining::new(capture, config)?, Some(error))),
    }
}
