//! Long work of an attempt that needs no device: on another thread, so that frames are served and cancellation is seen.

use std::ops::ControlFlow;

use crate::jobs::Lease;
use crate::store::{LeaseStatus, Release};
use crate::worker::thread::{Worker, serve_next};
use crate::worker::training::outcome::{AttemptEnd, AttemptError, settle};

impl Worker {
    /// What `work` makes, or how the attempt ended before that. Work whose result is not wanted any more runs to its end
    /// unheard.
    ///
    /// # Panics
    /// When `work` does.
    pub(super) async fn aside<T: Send + 'static>(
        &mut self,
        lease: &Lease,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<ControlFlow<AttemptEnd, T>, AttemptError> {
        let mut working = tokio::task::spawn_blocking(work);
        loop {
            tokio::select! {
                done = &mut working => {
                    let done = done.unwrap_or_else(|panic| std::panic::resume_unwind(panic.into_panic()));
                    return Ok(ControlFlow::Continue(done));
                }
                () = serve_next(&mut self.frames) => {}
                _ = self.changes.changed() => if lease.check().await? != LeaseStatus::Held {
                    return Ok(ControlFlow::Break(settle(lease).await?));
                },
                () = self.stop.cancelled() => {
                    lease.release(Release::Shutdown).await?;
                    return Ok(ControlFlow::Break(AttemptEnd::Stopped));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::mpsc;
    use std::time::Duration;

    use tempfile::TempDir;
    use tokio_util::sync::CancellationToken;

    use super::*;
    use crate::api::jobs::NewJob;
    use crate::api::marks::Marks;
    use crate::api::{JobId, TenantId};
    use crate::capture::{CaptureReport, ImportLimits};
    use crate::jobs::{Jobs, LeasePolicy, ManualClock, SequentialIds};
    use crate::store::{CaptureRecord, Store, Submitted};

    /// A worker without a GPU whose queue has one job.
    async fn worker(dir: &TempDir) -> (Worker, JobId) {
        let store = Store::open(dir.path()).await.unwrap();
        let capture = CaptureRecord {
            id: "capture".into(),
            sha256: "00".into(),
            bytes: 1,
            artifact: "captures/00".into(),
            marks: Marks::default(),
            report: CaptureReport::default(),
            made_of: None,
            created_ms: 0,
        };
        let tenant = TenantId::of_operator();
        store.insert_capture(&tenant, &capture, None).await.unwrap();
        let policy = LeasePolicy { duration: Duration::from_secs(60), max_idle_attempts: 3 };
        let clock = Arc::new(ManualClock::default());
        let jobs = Jobs::new(store, clock, Arc::new(SequentialIds::default()), policy);
        let job = NewJob { capture: "capture".into(), ..NewJob::default() };
        let submitted =
            jobs.submit(&tenant, job, 100, None, None, |job, _| job.id.to_string()).await.unwrap();
        let (Submitted::Created(id) | Submitted::Replayed(id)) = submitted;
        let changes = jobs.subscribe();
        let (stop, abandoned) = (CancellationToken::new(), CancellationToken::new());
        let worker = Worker {
            jobs,
            frames: None,
            steps: Arc::default(),
            previews: Arc::default(),
            import_limits: ImportLimits::default(),
            changes,
            stop,
            abandoned,
        };
        (worker, id.into())
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn work_aside_is_not_waited_for_once_its_job_is_cancelled() {
        let dir = TempDir::new().unwrap();
        let (mut worker, id) = worker(&dir).await;
        let lease = worker.jobs.claim().await.unwrap().unwrap();
        let done = worker.aside(&lease, || 7).await.unwrap_or_else(|error| panic!("{}", error.detail));
        assert_eq!(done, ControlFlow::Continue(7), "the control: nothing was cancelled");
        let (finish, finished) = mpsc::channel::<()>();
        let (began, begun) = tokio::sync::oneshot::channel();
        let jobs = worker.jobs.clone();
        tokio::spawn(async move {
            begun.await.unwrap();
            jobs.cancel(&TenantId::of_operator(), &id).await.unwrap();
        });
        let work = move || {
            began.send(()).unwrap();
            // Until the test has ended: whoever waits for this waits for ever.
            let _ = finished.recv();
        };
        let ending = worker.aside(&lease, work).await.unwrap_or_else(|error| panic!("{}", error.detail));
        assert_eq!(ending, ControlFlow::Break(AttemptEnd::Cancelled));
        drop(finish);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn work_aside_is_not_waited_for_when_the_server_stops() {
        let dir = TempDir::new().unwrap();
        let (mut worker, _) = worker(&dir).await;
        let lease = worker.jobs.claim().await.unwrap().unwrap();
        let (finish, finished) = mpsc::channel::<()>();
        let stop = worker.stop.clone();
        let work = move || {
            stop.cancel();
            let _ = finished.recv();
        };
        let ending = worker.aside(&lease, work).await.unwrap_or_else(|error| panic!("{}", error.detail));
        assert_eq!(ending, ControlFlow::Break(AttemptEnd::Stopped));
        drop(finish);
        assert!(worker.jobs.claim().await.unwrap().is_some(), "the job is in the queue again");
    }
}
