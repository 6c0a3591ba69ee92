//! Runs long work of an attempt that needs no device on another thread, so that a cancellation is handled immediately.

use std::ops::ControlFlow;

use tracing::Span;

use crate::worker::job_source::Claim;
use crate::worker::thread::Worker;
use crate::worker::training::outcome::{AttemptEnd, AttemptError, stop_attempt};
use relume_api::work::{LeaseStatus, Release};

impl Worker {
    /// Runs `work` on another thread. Returns its result, or the end of the attempt if that comes first; the work then continues,
    /// and its result is discarded.
    ///
    /// # Panics
    /// If `work` panics.
    pub(super) async fn run_in_background<T: Send + 'static>(
        &mut self,
        claim: &dyn Claim,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<ControlFlow<AttemptEnd, T>, AttemptError> {
        let span = Span::current();
        let mut working = tokio::task::spawn_blocking(move || span.in_scope(work));
        loop {
            tokio::select! {
                done = &mut working => {
                    let done = done.unwrap_or_else(|panic| std::panic::resume_unwind(panic.into_panic()));
                    return Ok(ControlFlow::Continue(done));
                }
                _ = self.changes.changed() => if claim.check().await? != LeaseStatus::Held {
                    return Ok(ControlFlow::Break(stop_attempt(claim).await?));
                },
                () = self.stop.cancelled() => {
                    claim.release(Release::Shutdown).await?;
                    return Ok(ControlFlow::Break(AttemptEnd::Stopped));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, mpsc};

    use tempfile::TempDir;
    use tokio_util::sync::CancellationToken;

    use super::*;
    use crate::jobs::{Jobs, LeasePolicy, ManualClock, Origin, SequentialIds};
    use crate::store::{CaptureRecord, Claimant, Store, Submitted};
    use crate::worker::job_source::{ClaimOutcome, JobSource};
    use crate::worker::local_jobs::LocalJobs;
    use crate::worker::opened_device::OpenedDevice;
    use relume_api::jobs::NewJob;
    use relume_api::metadata::ResourceMetadata;
    use relume_api::{JobId, TenantId};
    use relume_capture::ImportLimits;
    use relume_spec::CaptureReport;

    /// A worker without a GPU whose queue has one job.
    async fn worker(dir: &TempDir) -> (Worker, Jobs, JobId) {
        let store = Store::open(dir.path()).await.unwrap();
        let capture = CaptureRecord {
            id: "capture".into(),
            sha256: "00".into(),
            bytes: 1,
            artifact: "captures/00".into(),
            metadata: ResourceMetadata::default(),
            report: CaptureReport::default(),
            made_of: None,
            created_ms: 0,
        };
        let tenant = TenantId::of_operator();
        store.insert_capture(&tenant, &capture, None).await.unwrap();
        let policy = LeasePolicy { max_idle_attempts: 3, ..LeasePolicy::default() };
        let clock = Arc::new(ManualClock::default());
        let jobs = Jobs::new(store, clock, Arc::new(SequentialIds::default()), policy);
        let job = NewJob { capture: "capture".into(), ..NewJob::default() };
        let submitted = jobs
            .submit(&tenant, job, 100, Origin::default(), None, |job, _| job.id.to_string())
            .await
            .unwrap();
        let (Submitted::Created(id) | Submitted::Replayed(id)) = submitted;
        let source = LocalJobs::new(jobs.clone(), Claimant::default());
        let changes = source.changes();
        let (stop, abandoned) = (CancellationToken::new(), CancellationToken::new());
        let worker = Worker {
            source: Arc::new(source),
            device: OpenedDevice::cpu(),
            steps: Arc::default(),
            previews: Arc::default(),
            import_limits: ImportLimits::default(),
            changes,
            stop,
            abandoned,
            once: false,
        };
        (worker, jobs, id.into())
    }

    async fn claimed(worker: &Worker) -> Option<Box<dyn Claim>> {
        match worker.source.claim().await.unwrap() {
            ClaimOutcome::Job(claim) => Some(claim),
            ClaimOutcome::Nothing | ClaimOutcome::Draining => None,
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_cancelled_job_does_not_wait_for_its_background_task() {
        let dir = TempDir::new().unwrap();
        let (mut worker, jobs, id) = worker(&dir).await;
        let claim = claimed(&worker).await.unwrap();
        let done = worker
            .run_in_background(claim.as_ref(), || 7)
            .await
            .unwrap_or_else(|error| panic!("{}", error.detail));
        assert_eq!(done, ControlFlow::Continue(7), "the control: nothing was cancelled");
        let (finish, finished) = mpsc::channel::<()>();
        let (began, begun) = tokio::sync::oneshot::channel();
        tokio::spawn(async move {
            begun.await.unwrap();
            jobs.cancel(&TenantId::of_operator(), &id).await.unwrap();
        });
        let work = move || {
            began.send(()).unwrap();
            // Blocks until the end of the test.
            let _ = finished.recv();
        };
        let ending = worker
            .run_in_background(claim.as_ref(), work)
            .await
            .unwrap_or_else(|error| panic!("{}", error.detail));
        assert_eq!(ending, ControlFlow::Break(AttemptEnd::Cancelled));
        drop(finish);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_shutdown_does_not_wait_for_background_tasks() {
        let dir = TempDir::new().unwrap();
        let (mut worker, ..) = worker(&dir).await;
        let claim = claimed(&worker).await.unwrap();
        let (finish, finished) = mpsc::channel::<()>();
        let stop = worker.stop.clone();
        let work = move || {
            stop.cancel();
            let _ = finished.recv();
        };
        let ending = worker
            .run_in_background(claim.as_ref(), work)
            .await
            .unwrap_or_else(|error| panic!("{}", error.detail));
        assert_eq!(ending, ControlFlow::Break(AttemptEnd::Stopped));
        drop(finish);
        assert!(claimed(&worker).await.is_some(), "the job was returned to the queue");
    }
}
