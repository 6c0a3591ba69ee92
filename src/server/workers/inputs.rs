//! What workers fetch: the capture, a known light, the last checkpoint.

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use serde::Deserialize;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::{EnvironmentId, Problem};
use crate::jobs::StoredFile;
use crate::server::app::Shared;
use crate::server::description::File;
use crate::server::extract::UrlPath;
use crate::server::files;
use crate::server::workers::lease::Held;
use crate::store::ModelFile;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(get_capture_of_work))
        .routes(routes!(get_environment_of_work))
        .routes(routes!(get_checkpoint_of_work))
}

/// Fetch the capture of a job
///
/// For workers. Answers `Range` and `If-None-Match`; the `ETag` is the sha256 of the archive.
#[utoipa::path(
    get, path = "/v1/work/{job}/capture", tag = "workers",
    params(("job" = String, Path), ("Relume-Lease" = String, Header)),
    responses(
        (status = 200, content_type = "application/octet-stream", body = File), (status = 404, body = Problem),
        (status = 206, content_type = "application/octet-stream", body = File),
        (status = 409, body = Problem, description = "The lease is lost")
    )
)]
async fn get_capture_of_work(
    State(app): State<Shared>,
    Held(lease): Held,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let file = lease.capture().await?;
    send(&app, &headers, file.ok_or_else(|| Problem::not_found("capture", "of the job"))?).await
}

#[derive(Deserialize)]
struct EnvironmentOfWork {
    environment: EnvironmentId,
}

/// Fetch an environment map of a job's tenant
///
/// For workers; as the capture.
#[utoipa::path(
    get, path = "/v1/work/{job}/environments/{environment}", tag = "workers",
    params(("job" = String, Path), ("environment" = String, Path), ("Relume-Lease" = String, Header)),
    responses(
        (status = 200, content_type = "application/octet-stream", body = File), (status = 404, body = Problem),
        (status = 206, content_type = "application/octet-stream", body = File),
        (status = 409, body = Problem, description = "The lease is lost")
    )
)]
async fn get_environment_of_work(
    State(app): State<Shared>,
    Held(lease): Held,
    UrlPath(path): UrlPath<EnvironmentOfWork>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let file = lease.environment(&path.environment).await?;
    let missing = || Problem::not_found("environment", path.environment.as_str());
    send(&app, &headers, file.ok_or_else(missing)?).await
}

/// Fetch the checkpoint that a job goes on from
///
/// For workers; as the capture.
#[utoipa::path(
    get, path = "/v1/work/{job}/checkpoint", tag = "workers",
    params(("job" = String, Path), ("Relume-Lease" = String, Header)),
    responses(
        (status = 200, content_type = "application/octet-stream", body = File), (status = 404, body = Problem),
        (status = 206, content_type = "application/octet-stream", body = File),
        (status = 409, body = Problem, description = "The lease is lost")
    )
)]
async fn get_checkpoint_of_work(
    State(app): State<Shared>,
    Held(lease): Held,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let file = lease.last_checkpoint().await?;
    send(&app, &headers, file.ok_or_else(|| Problem::not_found("checkpoint", "of the job"))?).await
}

/// A file whose bytes were compared with their hash.
async fn send(app: &Shared, headers: &HeaderMap, file: StoredFile) -> Result<Response, Problem> {
    let size = tokio::fs::metadata(&file.path).await.map_err(Problem::storage_failed)?.len();
    let described = ModelFile {
        name: String::new(),
        content_type: "application/octet-stream".to_owned(),
        bytes: i64::try_from(size).map_err(Problem::internal)?,
        sha256: file.sha256,
        artifact: file.artifact,
    };
    files::send(app, headers, &described, async || Ok(())).await
}
