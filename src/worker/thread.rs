//! The training thread: takes jobs from a source.

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

/// How long an idle worker sleeps before it asks for a job unprompted.
const IDLE: Duration = Duration::from_secs(1);

/// How work on a job ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JobOutcome {
    /// Its model is published.
    Published,
    /// It has failed.
    Failed,
    /// It was cancelled, or another worker has it.
    LeaseLost,
    /// It is in the queue again.
    Requeued,
    /// There was none: the worker may not have any.
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

/// A thread that trains.
pub(super) struct Worker {
    pub(super) source: Arc<dyn JobSource>,
    /// What trains where a job does not say.
    pub(super) device: OpenedDevice,
    /// Training steps done.
    pub(super) steps: Arc<AtomicU64>,
    /// How what trains looks.
    pub(super) previews: Arc<Previews>,
    /// Bounds on captures.
    pub(super) import_limits: ImportLimits,
    pub(super) changes: watch::Receiver<()>,
    pub(super) stop: CancellationToken,
    /// Cancelled when nobody can ask for frames any more: the server has ended.
    pub(super) abandoned: CancellationToken,
    /// Whether it ends after one job, or when none waits.
    pub(super) once: bool,
}

impl Worker {
    /// Works until it is to stop. Returns how the last job ended, if there was one.
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
                    tracing::error!(why, "no job is given to this worker");
                    return Some(JobOutcome::Refused);
                }
                Err(error) => {
                    tracing::error!(%error, "no job can be claimed");
                    self.wait().await;
                }
            }
        }
        last
    }

    /// Waits until something may be due.
    pub(super) async fn wait(&mut self) {
        tokio::select! {
            () = self.stop.cancelled() => {}
            () = self.abandoned.cancelled() => self.stop.cancel(),
            _ = self.changes.changed() => {}
            () = tokio::time::sleep(IDLE) => {}
        }
    }

    /// What trains where a job does not say.
    pub(super) fn device(&self) -> &Device {
        self.device.device()
    }

    /// Makes one attempt at a job and records how it ended, also when it panics.
    async fn work(&mut self, claim: &dyn Claim) -> JobOutcome {
        let span = self.span_of(claim);
        self.attempt(claim).instrument(span).await
    }

    /// The span of an attempt: part of the trace of the request that made the job.
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
