//! How an attempt at a job ends.

use crate::worker::job_source::{Claim, JobSourceError};
use relume_api::work::LeaseStatus;
use relume_engine::DeviceError;
use relume_train::TrainError;

/// How an attempt ended without a failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::worker) enum AttemptEnd {
    /// The model is published.
    Published,
    /// The job was cancelled.
    Cancelled,
    /// The lease was lost; another worker may have the job.
    Lost,
    /// The server is stopping; the job is checkpointed and back in the queue.
    Stopped,
}

/// Code of failures to find or read a known light.
pub(super) const ENVIRONMENT_MISSING: &str = "environment_missing";
/// Code of failures after which the device is opened anew.
const DEVICE_FAILED: &str = "device_failed";
/// Code of failures that end when there is room on the disk.
const STORAGE_FULL: &str = "storage_full";
/// Code of failures that end when what keeps the jobs can be reached.
const UNREACHABLE: &str = "unreachable";

/// A failure that ends the attempt and, unless it is the device's or a full disk, the job.
pub(in crate::worker) struct AttemptError {
    /// Stable code.
    pub(in crate::worker) code: &'static str,
    /// A description for the user, without internals.
    pub(in crate::worker) detail: String,
}

impl AttemptError {
    pub(super) fn new(code: &'static str, detail: impl Into<String>) -> Self {
        Self { code, detail: detail.into() }
    }

    /// True when the device failed: it has to be opened anew, and the job may go on from its checkpoint.
    pub(in crate::worker) fn is_device_failure(&self) -> bool {
        self.code == DEVICE_FAILED
    }

    /// True when what keeps the jobs was away: the job goes on from its checkpoint, and nobody is to blame.
    pub(in crate::worker) fn is_outage(&self) -> bool {
        self.code == UNREACHABLE
    }

    /// True when the disk was full: the job goes on from its checkpoint once there is room.
    pub(in crate::worker) fn is_shortage(&self) -> bool {
        self.code == STORAGE_FULL
    }
}

impl From<JobSourceError> for AttemptError {
    fn from(error: JobSourceError) -> Self {
        tracing::error!(%error, "what keeps the jobs failed under one");
        match error {
            JobSourceError::Full => Self::new(STORAGE_FULL, "the disk is full"),
            JobSourceError::Unreachable(why) => Self::new(UNREACHABLE, why),
            JobSourceError::Damaged => Self::new("artifact_damaged", error.to_string()),
            JobSourceError::Gone => Self::new("artifact_damaged", "something that the job needs is gone"),
            JobSourceError::Failed(_) | JobSourceError::Refused(_) => {
                Self::new("storage_failed", "the store failed; the server's log says how")
            }
        }
    }
}

impl From<TrainError> for AttemptError {
    fn from(error: TrainError) -> Self {
        match error {
            // A model that is too large for the device stays so.
            TrainError::Device(error @ (DeviceError::TooLarge { .. } | DeviceError::Unavailable(_))) => {
                Self::new("device_unfit", error.to_string())
            }
            TrainError::Device(error) => Self::new(DEVICE_FAILED, error.to_string()),
            TrainError::Capture(error) => Self::new(error.code(), error.to_string()),
            TrainError::Memory(why) => Self::new("memory_unfit", why),
            error => Self::new("training_failed", error.to_string()),
        }
    }
}

/// Ends an attempt whose lease is lost or whose job is to be cancelled.
pub(in crate::worker) async fn stop_attempt(claim: &dyn Claim) -> Result<AttemptEnd, JobSourceError> {
    match claim.check().await? {
        LeaseStatus::Cancelling => {
            claim.confirm_cancel().await?;
            Ok(AttemptEnd::Cancelled)
        }
        LeaseStatus::Held | LeaseStatus::Lost => Ok(AttemptEnd::Lost),
    }
}
