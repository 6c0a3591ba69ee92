//! The training thread, which claims jobs from a source and runs them.

use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;

use futures::FutureExt;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;
use tracing::{Instrument, Span};

use crate::traces::{self, TraceParent};
use crate::worker::job_source::{Claim, ClaimOutcome, JobSource, JobSourceError};
use crate::worker::opened_device::OpenedDevice;
use crate::worker::panics::panic_message;
use crate::worker::previews::Previews;
use crate::worker::training::outcome::AttemptEnd;
use relume_capture::ImportLimits;
use relume_engine::Device;

/// Time after which an idle worker asks for a job without a notification.
const IDLE: Duration = Duration::from_secs(1);

/// Result of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JobOutcome {
    /// The model is published.
    Published,
    /// The job has failed.
    Failed,
    /// The job was cancelled, or another worker has it.
    LeaseLost,
    /// The job was returned to the queue.
    Requeued,
    /// The worker is not permitted to claim jobs.
    Refused,
}

impl From<AttemptEnd> for JobOutcome {
    fn from(end: AttemptEnd) -> Self {
        match end {
            AttemptEnd::Published => Self::Published,
            AttemptEnd::Cancelled | AttemptEnd::Lost => Self::LeaseLost,
            AttemptEnd::Stopped => Self::Requeued,
        }
    }
}

/// The state of a training thread.
pub(super) struct Worker {
    pub(super) source: Arc<dyn JobSource>,
    /// The device for jobs that do not request one.
    pub(super) device: OpenedDevice,
    /// Completed training steps.
    pub(super) steps: Arc<AtomicU64>,
    /// The previews of the running training.
    pub(super) previews: Arc<Previews>,
    /// Limits of captures.
    pub(super) import_limits: ImportLimits,
    pub(super) changes: watch::Receiver<()>,
    pub(super) stop: CancellationToken,
    /// Cancelled when the last device handle is dropped, because the server has ended.
    pub(super) abandoned: CancellationToken,
    /// Whether the worker exits after one job, or if no job is queued.
    pub(super) once: bool,
}

impl Worker {
    /// Runs jobs until the worker is stopped. Returns the result of the last job, if any.
    pub(super) async fn run(mut self) -> Option<JobOutcome> {
        let mut last = None;
        while !self.stop.is_cancelled() {
            self.changes.mark_unchanged();
            match self.source.clone().claim().await {
                Ok(ClaimOutcome::Job(claim)) => {
                    last = Some(self.work(claim.as_ref()).await);
                    if self.once {
                        break;
                    }
                }
                Ok(ClaimOutcome::Draining) => break,
                Ok(ClaimOutcome::Nothing) if self.once => break,
                Ok(ClaimOutcome::Nothing) => self.wait().await,
                Err(JobSourceError::Refused(why)) => {
                    tracing::error!(why, "the server refuses to give jobs to this worker");
                    return Some(JobOutcome::Refused);
                }
                Err(error) => {
                    tracing::error!(%error, "cannot claim a job");
                    self.wait().await;
                }
            }
        }
        last
    }

    /// Waits for a notification, a stop or the idle time.
    pub(super) async fn wait(&mut self) {
        tokio::select! {
            () = self.stop.cancelled() => {}
            () = self.abandoned.cancelled() => self.stop.cancel(),
            _ = self.changes.changed() => {}
            () = tokio::time::sleep(IDLE) => {}
        }
    }

    /// The device for jobs that do not request one.
    pub(super) fn device(&self) -> &Device {
        self.device.device()
    }

    /// Makes one attempt at a job and records its result, also after a panic.
    async fn work(&mut self, claim: &dyn Claim) -> JobOutcome {
        let span = self.span_of(claim);
        self.attempt(claim).instrument(span).await
    }

    /// The span of an attempt, in the trace of the request that created the job.
    fn span_of(&self, claim: &dyn Claim) -> Span {
        let task = claim.task();
        let worker = self.source.worker().map(tracing::field::display);
        let device = self.device_of(claim).map_or_else(|_| self.device().name(), Device::name);
        let span = tracing::info_span!("attempt", job = %task.job, number = task.attempt, worker, device);
        if let Some(parent) = task.traceparent.as_deref().and_then(TraceParent::parse) {
            traces::link_parent(&span, &parent);
        }
        span
    }

    async fn attempt(&mut self, claim: &dyn Claim) -> JobOutcome {
        self.device.renew();
        tracing::info!("started");
        let outcome = AssertUnwindSafe(self.train(claim)).catch_unwind().await;
        match outcome {
            Ok(Ok(ending)) => {
                tracing::info!(?ending, "ended");
                ending.into()
            }
            Ok(Err(failure)) => {
                tracing::warn!(code = failure.code, detail = failure.detail, "failed");
                traces::record_error(&Span::current(), failure.code);
                if failure.is_device_failure() {
                    self.device.reopen();
                }
                self.record_failure(claim, failure).await
            }
            Err(panic) => {
                let detail = panic_message(panic.as_ref());
                tracing::error!(detail, "the attempt panicked");
                traces::record_error(&Span::current(), "panic");
                self.record_panic(claim).await
            }
        }
    }
}
