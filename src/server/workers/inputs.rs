//! Downloads of workers: the capture, a known light, the last checkpoint.

use axum::extract::State;
use axum::response::Response;
use serde::Deserialize;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::jobs::{InputFile, Lease};
use crate::server::app::AppState;
use crate::server::description::File;
use crate::server::extract::UrlPath;
use crate::server::files::{self, FileRequest, Freshness};
use crate::server::problem::Problem;
use crate::server::workers::lease::Held;
use crate::store::ModelFile;
use relume_api::EnvironmentId;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(get_capture_of_work))
        .routes(routes!(get_environment_of_work))
        .routes(routes!(get_checkpoint_of_work))
}

/// Download the capture of a job
///
/// For workers. Supports `Range` and `If-None-Match`. The `ETag` is the SHA-256 of the archive.
#[utoipa::path(
    get, path = "/v1/work/{job}/capture", tag = "workers",
    params(
        ("job" = String, Path, description = "Job identifier"),
        ("Relume-Lease" = String, Header, description = "Lease token of the job")
    ),
    responses(
        (status = 200, content_type = "application/octet-stream", body = File), (status = 404, body = Problem),
        (status = 206, content_type = "application/octet-stream", body = File),
        (status = 307, description = "Redirect to the object store; the URL is valid for some minutes"),
        (status = 409, body = Problem, description = "The lease is no longer valid")
    )
)]
async fn get_capture_of_work(
    State(app): State<AppState>,
    Held(lease): Held,
    asked: FileRequest,
) -> Result<Response, Problem> {
    let file = lease.capture().await?;
    send(
        &app,
        &lease,
        &asked,
        file.ok_or_else(|| Problem::not_found("capture of job", lease.job().id.as_str()))?,
    )
    .await
}

#[derive(Deserialize)]
struct EnvironmentOfWork {
    environment: EnvironmentId,
}

/// Download an environment map for a job
///
/// For workers. Returns an environment map of the job's tenant. Supports `Range` and `If-None-Match`. The
/// `ETag` is the SHA-256 of the file.
#[utoipa::path(
    get, path = "/v1/work/{job}/environments/{environment}", tag = "workers",
    params(
        ("job" = String, Path, description = "Job identifier"),
        ("environment" = String, Path, description = "Environment map identifier"),
        ("Relume-Lease" = String, Header, description = "Lease token of the job")
    ),
    responses(
        (status = 200, content_type = "application/octet-stream", body = File), (status = 404, body = Problem),
        (status = 206, content_type = "application/octet-stream", body = File),
        (status = 307, description = "Redirect to the object store; the URL is valid for some minutes"),
        (status = 409, body = Problem, description = "The lease is no longer valid")
    )
)]
async fn get_environment_of_work(
    State(app): State<AppState>,
    Held(lease): Held,
    UrlPath(path): UrlPath<EnvironmentOfWork>,
    asked: FileRequest,
) -> Result<Response, Problem> {
    let file = lease.environment(&path.environment).await?;
    let missing = || Problem::not_found("environment", path.environment.as_str());
    send(&app, &lease, &asked, file.ok_or_else(missing)?).await
}

/// Download the last checkpoint of a job
///
/// For workers. Supports `Range` and `If-None-Match`. The `ETag` is the SHA-256 of the file.
#[utoipa::path(
    get, path = "/v1/work/{job}/checkpoint", tag = "workers",
    params(
        ("job" = String, Path, description = "Job identifier"),
        ("Relume-Lease" = String, Header, description = "Lease token of the job")
    ),
    responses(
        (status = 200, content_type = "application/octet-stream", body = File), (status = 404, body = Problem),
        (status = 206, content_type = "application/octet-stream", body = File),
        (status = 307, description = "Redirect to the object store; the URL is valid for some minutes"),
        (status = 409, body = Problem, description = "The lease is no longer valid")
    )
)]
async fn get_checkpoint_of_work(
    State(app): State<AppState>,
    Held(lease): Held,
    asked: FileRequest,
) -> Result<Response, Problem> {
    let file = lease.last_checkpoint();
    send(
        &app,
        &lease,
        &asked,
        file.ok_or_else(|| Problem::not_found("checkpoint of job", lease.job().id.as_str()))?,
    )
    .await
}

/// Answers with a file. Its hash is verified before any bytes are sent from this server.
async fn send(
    app: &AppState,
    lease: &Lease,
    asked: &FileRequest,
    file: InputFile,
) -> Result<Response, Problem> {
    let missing = || Problem::not_found("file", &file.artifact);
    let size = app.store.artifacts().size(&file.artifact).await?.ok_or_else(missing)?;
    let described = ModelFile {
        name: String::new(),
        content_type: "application/octet-stream".to_owned(),
        bytes: i64::try_from(size).map_err(Problem::internal)?,
        sha256: file.sha256.clone(),
        artifact: file.artifact.clone(),
    };
    files::send(app, asked, (&described, Freshness::ForEver), async || {
        Ok(lease.bring(&file).await.map(drop)?)
    })
    .await
}
