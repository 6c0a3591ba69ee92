//! The pose estimation stage: turns an upload of photographs into an upload of a capture.

use std::path::Path;
use std::sync::Arc;

use axum::http::StatusCode;
use tokio_util::sync::CancellationToken;

use super::queue::PoseJob;
use super::{folder, log, pack};
use crate::server::app::AppState;
use crate::server::problem::Problem;
use crate::server::tenant_turns::Turn;
use crate::store::StagedUpload;
use relume_api::problem::ContentError;
use relume_api::{CaptureId, TenantId};
use relume_capture::poses::{PoseError, RunControl, find_poses};
use relume_capture::{ImportLimits, PhotosWithoutPoses};

/// Whether an upload has photographs without poses and this server can find them.
pub(in crate::server) async fn needs_poses(
    app: &AppState,
    tenant: &TenantId,
    incoming: &StagedUpload,
) -> Result<bool, Problem> {
    Ok(app.poses.policy.is_on
        && are_photographs(app, tenant, incoming).await?
        && app.poses.check_available().await.is_ok())
}

/// The reason why this server finds no poses for an upload; `None` if the photographs have poses.
pub(in crate::server) async fn refusal(
    app: &AppState,
    tenant: &TenantId,
    incoming: &StagedUpload,
) -> Result<Option<String>, Problem> {
    if !are_photographs(app, tenant, incoming).await? {
        return Ok(None);
    }
    Ok(Some(match app.poses.check_available().await {
        Ok(()) => "this server finds poses for photographs sent to POST /v1/captures".to_owned(),
        Err(reason) => format!("this server does not find poses: {reason}"),
    }))
}

async fn are_photographs(
    app: &AppState,
    tenant: &TenantId,
    incoming: &StagedUpload,
) -> Result<bool, Problem> {
    let (path, limits) = (incoming.path.clone(), app.limits_of_uploads());
    // An upload that cannot be opened is refused by the validation, which gives the reason.
    let open = move || matches!(PhotosWithoutPoses::open(&path, &limits), Ok(Some(_)));
    app.decoders.run(tenant, open).await
}

/// Finds the poses of the photographs of an upload. Returns the posed capture in its place. If the server stops, the intermediate
/// files are kept for the next server; after a failure the log is kept.
pub(in crate::server) async fn find(
    app: &AppState,
    tenant: &TenantId,
    id: &CaptureId,
    photographs: StagedUpload,
    pose_job: PoseJob,
) -> Result<StagedUpload, Problem> {
    // If the result could not be stored, the estimation is not started.
    app.store.admit_bytes_of(tenant, photographs.bytes).await?;
    app.store.admit_bytes(photographs.bytes).await?;
    let pose_job = Arc::new(pose_job);
    let turn = tokio::select! {
        () = pose_job.cancelled.cancelled() => return Err(no_poses("cancelled", "the pose estimation was cancelled")),
        turn = app.poses.colmap_turn(tenant) => turn,
    };
    let folder = folder::of(&app.store, id);
    let work = PoseTask {
        app: app.clone(),
        folder: folder.clone(),
        pose_job: pose_job.clone(),
        turn,
        stop: app.stop.clone(),
    };
    let path = photographs.path.clone();
    let found = tokio::task::spawn_blocking(move || work.run(&path)).await.map_err(Problem::internal)?;
    found.map_err(|error| told(&error, &folder))?;
    if pose_job.cancelled.is_cancelled() {
        return Err(no_poses("cancelled", "the pose estimation was cancelled"));
    }
    let at = folder.clone();
    let log = tokio::task::spawn_blocking(move || log::log_tail(&at)).await.map_err(Problem::internal)?;
    let body = pack::tar(folder, log.map_err(Problem::storage_failed)?);
    let name: String = app.jobs.fresh_id();
    let received = app.store.receive(tenant, &name, body, app.limits.capture_bytes).await;
    Ok(received?.replacing(photographs))
}

/// The part of the stage that runs on a blocking thread.
struct PoseTask {
    app: AppState,
    folder: std::path::PathBuf,
    pose_job: Arc<PoseJob>,
    /// Held until COLMAP has ended, even if the caller no longer waits.
    turn: Turn,
    stop: CancellationToken,
}

impl PoseTask {
    fn run(self, upload: &Path) -> Result<(), PoseError> {
        let _turn = &self.turn;
        let policy = &self.app.poses.policy;
        let limits: ImportLimits = self.app.limits_of_uploads();
        let Some(photographs) = PhotosWithoutPoses::open(upload, &limits)? else { return Ok(()) };
        let mut progress = |progress| self.pose_job.set_progress(progress);
        let is_cancelled = || self.pose_job.cancelled.is_cancelled() || self.stop.is_cancelled();
        let mut run_control = RunControl::new(policy.timeout, &mut progress, &is_cancelled);
        let found = find_poses(&photographs, &self.folder, &policy.options(), &mut run_control)?;
        let placed = found.photographs - found.unregistered.len();
        tracing::info!(placed, photographs = found.photographs, "found poses");
        Ok(())
    }
}

/// The problem that the sender of the photographs receives.
fn told(error: &PoseError, folder: &Path) -> Problem {
    let detail = match error {
        PoseError::TooFewPlaced { placed, photographs, .. } => format!(
            "COLMAP placed {placed} of {photographs} photographs, fewer than half: take sharp, evenly lit photographs of textured \
             objects with more overlap; the log of the capture has the output of COLMAP"
        ),
        PoseError::TimedOut { program, minutes, .. } => format!(
            "the server stopped `{program}` after the time limit of {minutes} minutes; send fewer photographs, or find the poses \
             with `relume capture poses`"
        ),
        PoseError::Failed { program, status, end, .. } => {
            format!(
                "`{program}` failed ({status}); end of the log of the capture:\n{}",
                log::redact_folder(end, folder)
            )
        }
        other => log::redact_folder(&other.to_string(), folder),
    };
    match error {
        PoseError::TooFewPlaced { .. } => no_poses("too-few-placed", &detail),
        PoseError::TimedOut { .. } => no_poses("timed-out", &detail),
        PoseError::Failed { .. } | PoseError::NotInstalled { .. } | PoseError::TooOld { .. } => {
            no_poses("program-failed", &detail)
        }
        PoseError::Cancelled => no_poses("cancelled", "the pose estimation was cancelled"),
        PoseError::Capture(error) if error.is_users_fault() => {
            let (file, field) = (error.file().map(str::to_owned), error.field().map(str::to_owned));
            Problem::invalid_content(ContentError { code: error.code().to_owned(), file, field }, detail)
        }
        PoseError::Io { .. } | PoseError::FolderNotEmpty(_) | PoseError::Capture(_) => {
            Problem::storage_failed(error)
        }
    }
}

fn no_poses(code: &str, detail: &str) -> Problem {
    let title = "The server found no poses for the photographs";
    let mut problem = Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "no-poses", title).detail(detail);
    problem.content = Some(ContentError { code: code.to_owned(), file: None, field: None });
    problem
}
