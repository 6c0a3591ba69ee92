//! The stage itself: from an upload of photographs to one of a capture.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;
use std::sync::Arc;

use axum::http::StatusCode;
use flate2::read::MultiGzDecoder;
use tokio::sync::OwnedSemaphorePermit;
use tokio_util::sync::CancellationToken;

use super::desk::Ticket;
use super::{folder, log, pack};
use crate::api::problem::ContentError;
use crate::api::{CaptureId, Problem, TenantId};
use crate::capture::poses::{PoseError, Watch, find_poses};
use crate::capture::{ImportLimits, Unposed};
use crate::server::app::Shared;
use crate::store::Incoming;

/// Whether an upload is one of photographs without poses, and this server finds them.
pub(in crate::server) async fn are_wanted(app: &Shared, incoming: &Incoming) -> Result<bool, Problem> {
    Ok(app.poses.policy.is_on && are_photographs(app, incoming).await? && app.poses.is_able().await.is_ok())
}

/// Why this server finds no poses for an upload; `None` where it is not one of photographs without poses.
pub(in crate::server) async fn refusal(app: &Shared, incoming: &Incoming) -> Result<Option<String>, Problem> {
    if !are_photographs(app, incoming).await? {
        return Ok(None);
    }
    Ok(Some(match app.poses.is_able().await {
        Ok(()) => "this server finds them for what POST /v1/captures is sent".to_owned(),
        Err(reason) => format!("this server finds none: {reason}"),
    }))
}

async fn are_photographs(app: &Shared, incoming: &Incoming) -> Result<bool, Problem> {
    let (path, limits) = (incoming.path.clone(), app.import_limits);
    // What cannot be opened is refused by the validation, with its reason.
    app.decoders.run(move || matches!(Unposed::open(&path, &limits), Ok(Some(_)))).await
}

/// Finds the poses of the photographs of an upload: gives the posed capture in its place. What COLMAP makes on the way is kept for
/// the next server where this one ends, and its log where it fails.
pub(in crate::server) async fn find(
    app: &Shared,
    tenant: &TenantId,
    id: &CaptureId,
    photographs: Incoming,
    ticket: Ticket,
) -> Result<Incoming, Problem> {
    // What could not be stored in the end is not begun.
    app.store.admit_bytes_of(tenant, photographs.bytes).await?;
    app.store.admit_bytes(photographs.bytes).await?;
    let ticket = Arc::new(ticket);
    let turn = tokio::select! {
        () = ticket.cancelled.cancelled() => return Err(no_poses("cancelled", "it was cancelled")),
        turn = app.poses.turn() => turn?,
    };
    let folder = folder::of(&app.store, id);
    let work = Work {
        app: app.clone(),
        folder: folder.clone(),
        ticket: ticket.clone(),
        turn,
        stop: app.stop.clone(),
    };
    let path = photographs.path.clone();
    let found = tokio::task::spawn_blocking(move || work.run(&path)).await.map_err(Problem::internal)?;
    found.map_err(|error| told(&error, &folder))?;
    if ticket.cancelled.is_cancelled() {
        return Err(no_poses("cancelled", "it was cancelled"));
    }
    let at = folder.clone();
    let log = tokio::task::spawn_blocking(move || log::end_of_log(&at)).await.map_err(Problem::internal)?;
    let body = pack::tar(folder, log.map_err(Problem::storage_failed)?);
    let name: String = app.jobs.fresh_id();
    let received = app.store.receive(tenant, &name, body, app.limits.capture_bytes).await;
    Ok(received?.in_place_of(photographs))
}

/// What runs on a thread that may block.
struct Work {
    app: Shared,
    folder: std::path::PathBuf,
    ticket: Arc<Ticket>,
    /// Held until COLMAP has ended, not only while somebody waits for it.
    turn: OwnedSemaphorePermit,
    stop: CancellationToken,
}

impl Work {
    fn run(self, upload: &Path) -> Result<(), PoseError> {
        let _turn = &self.turn;
        let policy = &self.app.poses.policy;
        let limits: ImportLimits = self.app.import_limits;
        let plain = self.folder.join("photographs.tar");
        let upload = if unpack(upload, &plain, limits.max_gzip_bytes)? { &plain } else { upload };
        let Some(photographs) = Unposed::open(upload, &limits)? else { return Ok(()) };
        let mut progress = |progress| self.ticket.tell(progress);
        let is_cancelled = || self.ticket.cancelled.is_cancelled() || self.stop.is_cancelled();
        let mut watch = Watch::new(policy.timeout, &mut progress, &is_cancelled);
        let found = find_poses(&photographs, &self.folder, &policy.options(), &mut watch)?;
        let placed = found.photographs - found.unplaced.len();
        tracing::info!(placed, photographs = found.photographs, "found poses");
        Ok(())
    }
}

/// Writes what a gzipped archive holds to `plain`: it would be in memory for as long as COLMAP works. `false` for others.
fn unpack(upload: &Path, plain: &Path, limit: u64) -> Result<bool, PoseError> {
    let work = || {
        let mut magic = Vec::new();
        File::open(upload)?.take(2).read_to_end(&mut magic)?;
        if magic != [0x1f, 0x8b] {
            return Ok(false);
        }
        plain.parent().map_or(Ok(()), std::fs::create_dir_all)?;
        let unpacked = MultiGzDecoder::new(BufReader::new(File::open(upload)?));
        // It was opened before within this bound.
        std::io::copy(&mut unpacked.take(limit), &mut File::create(plain)?)?;
        Ok(true)
    };
    work().map_err(|source| PoseError::Io { file: plain.to_owned(), source })
}

/// Why there are no poses, for whoever sent the photographs.
fn told(error: &PoseError, folder: &Path) -> Problem {
    let detail = match error {
        PoseError::TooFewPlaced { placed, photographs, .. } => format!(
            "COLMAP placed {placed} of {photographs} photographs, fewer than half: take them with more overlap, sharp and evenly \
             lit, of things with texture; the log of the capture has its output"
        ),
        PoseError::TimedOut { program, minutes, .. } => format!(
            "`{program}` was stopped: this server lets COLMAP work for {minutes} minutes; send fewer photographs, or find the poses \
             by `relume capture poses`"
        ),
        PoseError::Failed { program, status, end, .. } => {
            format!(
                "`{program}` failed ({status}); the end of the log of the capture:\n{}",
                log::without(end, folder)
            )
        }
        other => log::without(&other.to_string(), folder),
    };
    match error {
        PoseError::TooFewPlaced { .. } => no_poses("too-few-placed", &detail),
        PoseError::TimedOut { .. } => no_poses("timed-out", &detail),
        PoseError::Failed { .. } | PoseError::NotInstalled { .. } | PoseError::TooOld { .. } => {
            no_poses("program-failed", &detail)
        }
        PoseError::Cancelled => no_poses("cancelled", "it was cancelled"),
        PoseError::Capture(error) if error.is_users_fault() => {
            let (file, field) = (error.file().map(str::to_owned), error.field().map(str::to_owned));
            Problem::invalid_content(ContentError { code: error.code().to_owned(), file, field }, detail)
        }
        PoseError::Io { .. } | PoseError::OfOthers(_) | PoseError::Capture(_) => {
            Problem::storage_failed(error)
        }
    }
}

fn no_poses(code: &str, detail: &str) -> Problem {
    let title = "No poses were found for the photographs";
    let mut problem = Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "no-poses", title).detail(detail);
    problem.content = Some(ContentError { code: code.to_owned(), file: None, field: None });
    problem
}
