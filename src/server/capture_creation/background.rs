//! Makes captures in the background, after the answer.

use std::time::Duration;

use crate::server::app::AppState;
use crate::server::capture_creation::existing::duplicate_capture;
use crate::server::capture_creation::publish::{create, create_with_poses};
use crate::server::poses::{self, PoseJob};
use crate::server::problem::Problem;
use crate::server::uploads;
use crate::store::{StagedUpload, StoreError};
use relume_api::metadata::ResourceMetadata;
use relume_api::problem::{ContentError, TYPE_PREFIX};
use relume_api::{CaptureId, TenantId};

/// Pause before a creation is tried again while the object store cannot be reached.
const RETRY_INTERVAL: Duration = Duration::from_secs(2);

/// Number of servers that may end in succession during the validation of a capture. The capture is probably the cause.
const MAX_INTERRUPTIONS: i64 = 5;

/// The problem of a capture whose validation ended several servers.
fn interrupted() -> Problem {
    let content = ContentError { code: "validation_interrupted".to_owned(), file: None, field: None };
    Problem::invalid_content(
        content,
        format!(
            "{MAX_INTERRUPTIONS} servers ended in succession while they validated this capture, e.g. because the memory did not suffice; \
             send smaller or fewer photographs, or give the server more memory and send the capture again"
        ),
    )
}

/// Continues the creations of a terminated server.
pub(in crate::server) async fn resume(app: AppState) -> Result<(), StoreError> {
    for upload in app.store.pending_validations().await? {
        let (Some(capture), Some(lock)) = (upload.capture_id.clone(), app.store.lock_upload(&upload.id))
        else {
            continue;
        };
        let creation = Creation { app: app.clone(), tenant: upload.tenant.clone(), capture };
        if app.store.count_interrupted_validation(&upload.id).await? >= MAX_INTERRUPTIONS {
            creation.record(Outcome::Invalid(Box::new(interrupted()))).await;
            continue;
        }
        let name: String = app.jobs.fresh_id();
        let incoming = app.store.finalise_upload(lock, &upload, &name).await?;
        creation.start(incoming, None);
    }
    Ok(())
}

/// A creation in the state `validating`.
pub(super) struct Creation {
    pub(super) app: AppState,
    pub(super) tenant: TenantId,
    pub(super) capture: CaptureId,
}

/// How a creation leaves the state `validating`.
enum Outcome {
    Ready,
    Invalid(Box<Problem>),
    /// The upload was deleted.
    Gone,
}

impl Creation {
    /// Makes the capture in a task of its own. When the server stops, the creation stays in its state for the next server.
    pub(super) fn start(self, incoming: StagedUpload, pose_job: Option<PoseJob>) {
        tokio::spawn(async move {
            let stopped = self.app.stop.clone().cancelled_owned();
            let ended = async { self.record(self.run(incoming, pose_job).await).await };
            tokio::select! { biased; () = stopped => {}, () = ended => {} }
        });
    }

    async fn run(&self, incoming: StagedUpload, pose_job: Option<PoseJob>) -> Outcome {
        let mut attempt = self.attempt(incoming, pose_job).await;
        loop {
            match attempt {
                Ok(()) => return Outcome::Ready,
                Err(problem) if !is_outage(&problem) => return Outcome::Invalid(Box::new(problem)),
                Err(_) => tokio::time::sleep(RETRY_INTERVAL).await,
            }
            attempt = match self.reopen_upload().await {
                Ok(Some(incoming)) => self.attempt(incoming, None).await,
                Ok(None) => return Outcome::Gone,
                Err(error) => Err(error.into()),
            };
        }
    }

    async fn attempt(&self, incoming: StagedUpload, mut pose_job: Option<PoseJob>) -> Result<(), Problem> {
        let Self { app, tenant, capture } = self;
        // Another request made the capture in the meantime.
        if let Some(same) = app.store.capture_of_content(tenant, &incoming.sha256).await? {
            return Err(duplicate_capture(&same));
        }
        if pose_job.is_none() && poses::needs_poses(app, tenant, &incoming).await? {
            pose_job = Some(app.poses.enqueue(capture));
        }
        let id = capture.clone();
        let made = match pose_job {
            Some(pose_job) => create_with_poses(app, tenant, id, incoming, pose_job).await?,
            // The current metadata are recorded with the upload.
            None => create(app, tenant, id, incoming, ResourceMetadata::default()).await?,
        };
        if made.id == *capture { Ok(()) } else { Err(duplicate_capture(&made)) }
    }

    /// The bytes of the upload, again; `None` if the upload no longer exists.
    async fn reopen_upload(&self) -> Result<Option<StagedUpload>, StoreError> {
        let Self { app, tenant, capture } = self;
        let Some(upload) = app.store.upload_of_capture(tenant, capture).await? else { return Ok(None) };
        let Some(lock) = app.store.lock_upload(&upload.id) else { return Ok(None) };
        let name: String = app.jobs.fresh_id();
        app.store.finalise_upload(lock, &upload, &name).await.map(Some)
    }

    async fn record(&self, outcome: Outcome) {
        let Self { app, capture, .. } = self;
        let problem = match outcome {
            Outcome::Gone => return,
            Outcome::Ready => None,
            Outcome::Invalid(problem) => Some(problem),
        };
        poses::clean_up(&app.store, capture, problem.is_some()).await;
        let Some(problem) = problem else { return };
        tracing::info!(%capture, kind = problem.kind, "no capture could be made of an upload");
        let until = uploads::expiry(app);
        if let Err(error) = app.store.end_validation(capture, &problem, until).await {
            tracing::error!(%error, %capture, "cannot record the end of a validation; the next start validates the upload again");
        }
    }
}

/// Whether a problem is an outage of the object store, so that the creation must be retried.
fn is_outage(problem: &Problem) -> bool {
    problem.kind.strip_prefix(TYPE_PREFIX) == Some("artifacts-unreachable")
}
