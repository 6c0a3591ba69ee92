//! `/v1/workers`: who works, and who shall stop.

use axum::Json;
use axum::extract::State;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::work::{WorkerChange, WorkerView};
use crate::api::{List, Problem, WorkerId};
use crate::server::app::Shared;
use crate::server::extract::{JsonBody, UrlPath};

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(list_workers)).routes(routes!(get_worker, change_worker))
}

/// List workers
///
/// All of them, by name: threads of the server, and those with a process of their own. One that was not heard of for a minute is
/// `lost`; after a day it is forgotten. For whoever runs the server.
#[utoipa::path(get, path = "/v1/workers", tag = "workers", responses((status = 200, body = List<WorkerView>)))]
async fn list_workers(State(app): State<Shared>) -> Result<Json<List<WorkerView>>, Problem> {
    let alive = app.jobs.alive_ms();
    let items = app.store.workers().await?.into_iter().map(|worker| worker.view(alive)).collect();
    Ok(Json(List { items, next: None }))
}

/// Get a worker
#[utoipa::path(
    get, path = "/v1/workers/{id}", tag = "workers", params(("id" = String, Path)),
    responses((status = 200, body = WorkerView), (status = 404, body = Problem))
)]
async fn get_worker(
    State(app): State<Shared>,
    UrlPath(id): UrlPath<WorkerId>,
) -> Result<Json<WorkerView>, Problem> {
    let worker = app.store.worker(&id).await?.ok_or_else(|| missing(&id))?;
    Ok(Json(worker.view(app.jobs.alive_ms())))
}

/// Drain a worker
///
/// With `{"draining": true}` it is given no more jobs; the one that it has goes on. A worker with a process of its own then ends, one
/// that is a thread of the server waits until it is told otherwise.
#[utoipa::path(
    patch, path = "/v1/workers/{id}", tag = "workers", params(("id" = String, Path)), request_body = WorkerChange,
    responses((status = 200, body = WorkerView), (status = 404, body = Problem), (status = 422, body = Problem))
)]
async fn change_worker(
    State(app): State<Shared>,
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
