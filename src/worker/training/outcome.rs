//! The end of an attempt at a job.

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
    /// The worker is stopping; the job was checkpointed and returned to the queue.
    Stopped,
}

/// Code of a known light that is missing or unreadable.
pub(super) const ENVIRONMENT_MISSING: &str = "environment_missing";
/// Code of a device failure, after which the device is reopened.
const DEVICE_FAILED: &str = "device_failed";
/// Code of a full disk. The job waits for disk space.
const STORAGE_FULL: &str = "storage_full";
/// Code of a job source that cannot be reached.
const UNREACHABLE: &str = "unreachable";

/// A failure that ends the attempt and, unless it is a device failure, an outage or a full disk, the job.
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

    /// Whether the device failed. It must be reopened, and the job can continue from its checkpoint.
    pub(in crate::worker) fn is_device_failure(&self) -> bool {
        self.code == DEVICE_FAILED
    }

    /// Whether the job source could not be reached. The job continues from its checkpoint, and the attempt is not counted.
    pub(in crate::worker) fn is_outage(&self) -> bool {
        self.code == UNREACHABLE
    }

    /// Whether the disk was full. The job continues from its checkpoint when there is disk space.
    pub(in crate::worker) fn is_shortage(&self) -> bool {
        self.code == STORAGE_FULL
    }
}

impl From<JobSourceError> for AttemptError {
    fn from(error: JobSourceError) -> Self {
        tracing::error!(%error, "the job source failed during a job");
        match error {
            JobSourceError::Full => Self::new(STORAGE_FULL, "the disk is full"),
            JobSourceError::Unreachable(why) => Self::new(UNREACHABLE, why),
            JobSourceError::Damaged => Self::new("artifact_damaged", error.to_string()),
            JobSourceError::Gone => Self::new("artifact_damaged", "a resource of the job no longer exists"),
            JobSourceError::Failed(_) | JobSourceError::Refused(_) => {
                Self::new("storage_failed", "the store failed; see the log of the server")
            }
        }
    }
}

impl From<TrainError> for AttemptError {
    fn from(error: TrainError) -> Self {
        match error {
            // A retry cannot help if the model is too large for the device.
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

/// Ends an attempt whose lease is lost or whose job is cancelled.
pub(in crate::worker) async fn stop_attempt(claim: &dyn Claim) -> Result<AttemptEnd, JobSourceError> {
    match claim.check().await? {
        LeaseStatus::Cancelling => {
            claim.confirm_cancel().await?;
            Ok(AttemptEnd::Cancelled)
        }
        LeaseStatus::Held | LeaseStatus::Lost => Ok(AttemptEnd::Lost),
    }
}
