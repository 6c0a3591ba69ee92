//! `DELETE` of captures, environments, jobs and models.

use std::time::Duration;

use axum::extract::State;
use axum::http::StatusCode;
use serde::Deserialize;
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::extract::{QueryString, UrlPath};
use crate::server::poses;
use crate::server::problem::Problem;
use crate::store::Deletion;
use relume_api::{CaptureId, ResourceKind, ResourceName};

/// Interval and number of checks whether cancelled work has ended.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
const MAX_POLLS: u32 = 200;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(delete_capture))
        .routes(routes!(delete_environment))
        .routes(routes!(delete_job))
        .routes(routes!(delete_model))
}

/// Scope of a deletion.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct DeleteQuery {
    /// `true`: also deletes the resources that need this one, and cancels running jobs. Omitted: `false`.
    #[serde(default)]
    #[param(required = false)]
    cascade: bool,
}

/// Delete a capture
///
/// Jobs of the capture that are queued, running or retryable need it; the server then answers 409 unless
/// `cascade` is `true`. Models of the capture remain. A running pose estimation is cancelled.
#[utoipa::path(
    delete, path = "/v1/captures/{id}", tag = "captures",
    params(("id" = String, Path, description = "Capture identifier"), DeleteQuery),
    responses(
        (status = 204, description = "Deleted"), (status = 404, body = Problem, description = "Not found"),
        (status = 409, body = Problem, description = "In use; `needed_by` lists the dependent resources")
    )
)]
async fn delete_capture(
    app: State<AppState>,
    caller: Caller,
    id: UrlPath<String>,
    query: QueryString<DeleteQuery>,
) -> Result<StatusCode, Problem> {
    delete(app, &caller, ResourceKind::Capture, id, query).await
}

/// Delete an environment map
///
/// Jobs that use the map as a known light and are queued, running or retryable need it; the server then
/// answers 409 unless `cascade` is `true`.
#[utoipa::path(
    delete, path = "/v1/environments/{id}", tag = "environments",
    params(("id" = String, Path, description = "Environment map identifier"), DeleteQuery),
    responses(
        (status = 204, description = "Deleted"), (status = 404, body = Problem, description = "Not found"),
        (status = 409, body = Problem, description = "In use; `needed_by` lists the dependent resources")
    )
)]
async fn delete_environment(
    app: State<AppState>,
    caller: Caller,
    id: UrlPath<String>,
    query: QueryString<DeleteQuery>,
) -> Result<StatusCode, Problem> {
    delete(app, &caller, ResourceKind::Environment, id, query).await
}

/// Delete a job
///
/// Deletes the job with its events and its checkpoint. The model remains. For a running job the server
/// answers 409 unless `cascade` is `true`; then it cancels the job first.
#[utoipa::path(
    delete, path = "/v1/jobs/{id}", tag = "jobs",
    params(("id" = String, Path, description = "Job identifier"), DeleteQuery),
    responses(
        (status = 204, description = "Deleted"), (status = 404, body = Problem, description = "Not found"),
        (status = 409, body = Problem, description = "The job is running")
    )
)]
async fn delete_job(
    app: State<AppState>,
    caller: Caller,
    id: UrlPath<String>,
    query: QueryString<DeleteQuery>,
) -> Result<StatusCode, Problem> {
    delete(app, &caller, ResourceKind::Job, id, query).await
}

/// Delete a model
///
/// Deletes the model with its files. The job remains and records the time in `model_deleted_at`. No other
/// resource needs a model, so `cascade` has no effect.
#[utoipa::path(
    delete, path = "/v1/models/{id}", tag = "models",
    params(("id" = String, Path, description = "Model identifier"), DeleteQuery),
    responses(
        (status = 204, description = "Deleted"), (status = 404, body = Problem, description = "Not found")
    )
)]
async fn delete_model(
    app: State<AppState>,
    caller: Caller,
    id: UrlPath<String>,
    query: QueryString<DeleteQuery>,
) -> Result<StatusCode, Problem> {
    delete(app, &caller, ResourceKind::Model, id, query).await
}

async fn delete(
    State(app): State<AppState>,
    caller: &Caller,
    kind: ResourceKind,
    UrlPath(id): UrlPath<String>,
    QueryString(query): QueryString<DeleteQuery>,
) -> Result<StatusCode, Problem> {
    let what = ResourceName::new(kind, id);
    match app.jobs.delete(&caller.tenant, &what, query.cascade).await? {
        Deletion::Done => {
            app.gc_wake.notify_one();
            Ok(StatusCode::NO_CONTENT)
        }
        Deletion::NotFound if kind == ResourceKind::Capture => {
            delete_unfinished_capture(&app, caller, what.id.into()).await
        }
        Deletion::NotFound => Err(Problem::not_found(kind.name(), &what.id)),
        Deletion::InUse(needed_by) => Err(Problem::in_use(&what, needed_by)),
    }
}

/// Deletes a capture that is invalid, or whose poses are being found, with its upload.
pub(super) async fn delete_unfinished_capture(
    app: &AppState,
    caller: &Caller,
    id: CaptureId,
) -> Result<StatusCode, Problem> {
    let missing = || Problem::not_found("capture", id.as_str());
    let upload = app.store.upload_of_capture(&caller.tenant, &id).await?.ok_or_else(missing)?;
    let ends_soon = app.poses.cancel(&id);
    for _ in 0..MAX_POLLS {
        if app.store.drop_invalid(&upload).await? {
            poses::remove_folder(&app.store, &id).await;
            // It may have become a capture in the meantime.
            let what = ResourceName::new(ResourceKind::Capture, id.to_string());
            app.jobs.delete(&caller.tenant, &what, false).await?;
            return Ok(StatusCode::NO_CONTENT);
        }
        if !ends_soon {
            break;
        }
        tokio::time::sleep(POLL_INTERVAL).await;
    }
    Err(Problem::conflict("capture-validating", "the server is validating the capture").retry_after(5))
}
