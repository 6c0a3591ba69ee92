//! `/v1/workers`: the worker registry, with drain and resume.

use axum::Json;
use axum::extract::State;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::extract::{JsonBody, UrlPath};
use crate::server::problem::Problem;
use relume_api::work::{WorkerChange, WorkerView};
use relume_api::{List, WorkerId};

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(list_workers)).routes(routes!(get_worker, change_worker))
}

/// List workers
///
/// For the operator. Returns all local workers (threads of the server) and remote workers (separate
/// processes), sorted by name. A worker without a heartbeat for a minute has the state `lost`. The server
/// removes it from the list after a day.
#[utoipa::path(get, path = "/v1/workers", tag = "workers", responses((status = 200, body = List<WorkerView>)))]
async fn list_workers(State(app): State<AppState>) -> Result<Json<List<WorkerView>>, Problem> {
    let alive = app.jobs.heartbeat_cutoff_ms();
    let items = app.store.workers().await?.into_iter().map(|worker| worker.view(alive)).collect();
    Ok(Json(List { items, next: None }))
}

/// Get a worker
///
/// For the operator.
#[utoipa::path(
    get, path = "/v1/workers/{id}", tag = "workers", params(("id" = String, Path, description = "Worker identifier")),
    responses((status = 200, body = WorkerView), (status = 404, body = Problem))
)]
async fn get_worker(
    State(app): State<AppState>,
    UrlPath(id): UrlPath<WorkerId>,
) -> Result<Json<WorkerView>, Problem> {
    let worker = app.store.worker(&id).await?.ok_or_else(|| missing(&id))?;
    Ok(Json(worker.view(app.jobs.heartbeat_cutoff_ms())))
}

/// Drain or resume a worker
///
/// For the operator. With `{"draining": true}` the server gives the worker no more jobs; the current job
/// continues. A remote worker then exits. A local worker waits until it is resumed with
/// `{"draining": false}`.
#[utoipa::path(
    patch, path = "/v1/workers/{id}", tag = "workers",
    params(("id" = String, Path, description = "Worker identifier")),
    request_body = WorkerChange,
    responses((status = 200, body = WorkerView), (status = 404, body = Problem), (status = 422, body = Problem))
)]
async fn change_worker(
    State(app): State<AppState>,
    UrlPath(id): UrlPath<WorkerId>,
    JsonBody(change): JsonBody<WorkerChange>,
) -> Result<Json<WorkerView>, Problem> {
    if !app.store.set_draining(&id, change.draining).await? {
        return Err(missing(&id));
    }
    get_worker(State(app), UrlPath(id)).await
}

fn missing(id: &WorkerId) -> Problem {
    Problem::not_found("worker", id.as_str())
}
