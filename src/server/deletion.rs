//! `DELETE` of captures, environments, jobs and models.

use std::time::Duration;

use axum::extract::State;
use axum::http::StatusCode;
use serde::Deserialize;
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::{CaptureId, Problem, ResourceKind, ResourceName};
use crate::server::app::Shared;
use crate::server::caller::Caller;
use crate::server::extract::{QueryString, UrlPath};
use crate::server::poses;
use crate::store::Deletion;

/// How often, and how many times, it is asked whether work that was cancelled has ended.
const LOOK_EVERY: Duration = Duration::from_millis(50);
const LOOKS: u32 = 200;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(delete_capture))
        .routes(routes!(delete_environment))
        .routes(routes!(delete_job))
        .routes(routes!(delete_model))
}

/// What to delete beside the thing itself.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct DeleteQuery {
    /// `true`: delete what needs it as well; a job that runs is cancelled. `false` when absent.
    #[serde(default)]
    #[param(required = false)]
    cascade: bool,
}

/// Delete a capture
///
/// Jobs that wait, run or may be run again need it. Models that were made of it stay. The search for the poses of its photographs is
/// ended.
#[utoipa::path(
    delete, path = "/v1/captures/{id}", tag = "captures", params(("id" = String, Path), DeleteQuery),
    responses(
        (status = 204, description = "Deleted"), (status = 404, body = Problem, description = "There is none, or no longer"),
        (status = 409, body = Problem, description = "Needed; `needed_by` says by what")
    )
)]
async fn delete_capture(
    app: State<Shared>,
    caller: Caller,
    id: UrlPath<String>,
    query: QueryString<DeleteQuery>,
) -> Result<StatusCode, Problem> {
    delete(app, &caller, ResourceKind::Capture, id, query).await
}

/// Delete an environment map
///
/// Jobs that wait, run or may be run again need it if they hold it as a known light.
#[utoipa::path(
    delete, path = "/v1/environments/{id}", tag = "environments", params(("id" = String, Path), DeleteQuery),
    responses(
        (status = 204, description = "Deleted"), (status = 404, body = Problem, description = "There is none, or no longer"),
        (status = 409, body = Problem, description = "Needed; `needed_by` says by what")
    )
)]
async fn delete_environment(
    app: State<Shared>,
    caller: Caller,
    id: UrlPath<String>,
    query: QueryString<DeleteQuery>,
) -> Result<StatusCode, Problem> {
    delete(app, &caller, ResourceKind::Environment, id, query).await
}

/// Delete a job
///
/// With its history and its checkpoint; its model stays. A job that runs is deleted with `cascade` only.
#[utoipa::path(
    delete, path = "/v1/jobs/{id}", tag = "jobs", params(("id" = String, Path), DeleteQuery),
    responses(
        (status = 204, description = "Deleted"), (status = 404, body = Problem, description = "There is none, or no longer"),
        (status = 409, body = Problem, description = "It is running")
    )
)]
async fn delete_job(
    app: State<Shared>,
    caller: Caller,
    id: UrlPath<String>,
    query: QueryString<DeleteQuery>,
) -> Result<StatusCode, Problem> {
    delete(app, &caller, ResourceKind::Job, id, query).await
}

/// Delete a model
///
/// With its files. Its job stays and says when this happened. Nothing needs a model.
#[utoipa::path(
    delete, path = "/v1/models/{id}", tag = "models", params(("id" = String, Path), DeleteQuery),
    responses(
        (status = 204, description = "Deleted"), (status = 404, body = Problem, description = "There is none, or no longer")
    )
)]
async fn delete_model(
    app: State<Shared>,
    caller: Caller,
    id: UrlPath<String>,
    query: QueryString<DeleteQuery>,
) -> Result<StatusCode, Problem> {
    delete(app, &caller, ResourceKind::Model, id, query).await
}

async fn delete(
    State(app): State<Shared>,
    caller: &Caller,
    kind: ResourceKind,
    UrlPath(id): UrlPath<String>,
    QueryString(query): QueryString<DeleteQuery>,
) -> Result<StatusCode, Problem> {
    let what = ResourceName::new(kind, id);
    match app.jobs.delete(&caller.tenant, &what, query.cascade).await? {
        Deletion::Done => {
            app.tidy.notify_one();
            Ok(StatusCode::NO_CONTENT)
        }
        Deletion::NotFound if kind == ResourceKind::Capture => {
            delete_unmade(&app, caller, what.id.into()).await
        }
        Deletion::NotFound => Err(Problem::not_found(kind.name(), &what.id)),
        Deletion::InUse(needed_by) => Err(Problem::in_use(&what, needed_by)),
    }
}

/// Deletes a capture that could not be made, or that poses are being found for, with its upload.
pub(super) async fn delete_unmade(
    app: &Shared,
    caller: &Caller,
    id: CaptureId,
) -> Result<StatusCode, Problem> {
    let missing = || Problem::not_found("capture", id.as_str());
    let upload = app.store.upload_for(&caller.tenant, &id).await?.ok_or_else(missing)?;
    let ends_soon = app.poses.cancel(&id);
    for _ in 0..LOOKS {
        if app.store.drop_invalid(&upload).await? {
            poses::remove_of(&app.store, &id).await;
            // It may have become one meanwhile.
            let what = ResourceName::new(ResourceKind::Capture, id.to_string());
            app.jobs.delete(&caller.tenant, &what, false).await?;
            return Ok(StatusCode::NO_CONTENT);
        }
        if !ends_soon {
            break;
        }
        tokio::time::sleep(LOOK_EVERY).await;
    }
    Err(Problem::conflict("capture-validating", "the capture is being validated").retry_after(5))
}
