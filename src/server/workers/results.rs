//! Uploads of workers: checkpoints and the files of models.

use axum::Json;
use axum::extract::{Request, State};
use futures::TryStreamExt;
use serde::Deserialize;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::jobs::Lease;
use crate::server::app::AppState;
use crate::server::description::File;
use crate::server::extract::UrlPath;
use crate::server::problem::Problem;
use crate::server::workers::lease::{Held, lease_view};
use crate::store::StagedUpload;
use relume_api::work::{LeaseView, SentFile};

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(put_checkpoint)).routes(routes!(put_file_of_work))
}

#[derive(Deserialize)]
struct CheckpointPath {
    step: u32,
}

/// Upload a checkpoint
///
/// For workers. The next attempt continues from the checkpoint. It replaces the previous checkpoint when it
/// is complete.
#[utoipa::path(
    put, path = "/v1/work/{job}/checkpoints/{step}", tag = "workers",
    request_body(content((File = "application/octet-stream"))),
    params(
        ("job" = String, Path, description = "Job identifier"),
        ("step" = u32, Path, description = "Training step of the checkpoint"),
        ("Relume-Lease" = String, Header, description = "Lease token of the job")
    ),
    responses((status = 200, body = LeaseView), (status = 409, body = Problem, description = "The lease is no longer valid"))
)]
async fn put_checkpoint(
    State(app): State<AppState>,
    Held(lease): Held,
    UrlPath(path): UrlPath<CheckpointPath>,
    request: Request,
) -> Result<Json<LeaseView>, Problem> {
    let bytes = receive(&app, &lease, request).await?;
    lease_view(lease.take_checkpoint(i64::from(path.step), bytes).await).map(Json)
}

#[derive(Deserialize)]
struct FilePath {
    name: String,
}

/// Upload a file of a model
///
/// For workers, before the model is published. File names have 1 to 64 characters of A-Z, a-z, 0-9, `.`, `_`
/// and `-`, and start neither with `.` nor with `checkpoint`.
#[utoipa::path(
    put, path = "/v1/work/{job}/files/{name}", tag = "workers",
    request_body(content((File = "application/octet-stream"))),
    params(
        ("job" = String, Path, description = "Job identifier"),
        ("name" = String, Path, description = "File name"),
        ("Relume-Lease" = String, Header, description = "Lease token of the job")
    ),
    responses((status = 200, body = SentFile), (status = 409, body = Problem, description = "The lease is no longer valid"))
)]
async fn put_file_of_work(
    State(app): State<AppState>,
    Held(lease): Held,
    UrlPath(path): UrlPath<FilePath>,
    request: Request,
) -> Result<Json<SentFile>, Problem> {
    check_name(&path.name, "/name")?;
    let bytes = receive(&app, &lease, request).await?;
    Ok(Json(lease.take_file(&path.name, bytes).await?))
}

/// # Errors
/// 422 for an invalid name of a model's file; the field is `pointer`.
pub(super) fn check_name(name: &str, pointer: &str) -> Result<(), Problem> {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
    let is_name = (1..=64).contains(&name.len()) && name.chars().all(plain) && !name.starts_with('.');
    if is_name && !name.starts_with("checkpoint") {
        return Ok(());
    }
    let why = "must have 1 to 64 characters of A-Z, a-z, 0-9, `.`, `_` and `-`, and must not start with `.` or `checkpoint`";
    Err(Problem::invalid_field(pointer, why))
}

/// Streams a body to disk, with its bytes counted for the job's tenant.
async fn receive(app: &AppState, lease: &Lease, request: Request) -> Result<StagedUpload, Problem> {
    let body = request.into_body().into_data_stream().map_err(|error| error.to_string());
    let name: String = app.jobs.fresh_id();
    Ok(app.store.receive(&lease.job().tenant, &name, body, app.limits.capture_bytes).await?)
}
