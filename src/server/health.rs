//! `/healthz`, `/readyz`, `/metrics` and the API's own description.

use std::time::Instant;

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use utoipa::openapi::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::Problem;
use crate::api::jobs::JobState;
use crate::api::work::WorkerState;
use crate::server::app::Shared;
use crate::server::observe;
use crate::store::StoreError;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(healthz))
        .routes(routes!(readyz))
        .routes(routes!(prometheus))
        .routes(routes!(description))
}

/// Check that the process runs
#[utoipa::path(get, path = "/healthz", tag = "operations", responses((status = 200, body = String)))]
async fn healthz() -> &'static str {
    "ok\n"
}

/// Check that the server can work
#[utoipa::path(
    get, path = "/readyz", tag = "operations",
    responses(
        (status = 200, body = String),
        (status = 503, body = Problem, description = "The detail says why, e.g. a full disk")
    )
)]
async fn readyz(State(app): State<Shared>) -> Result<&'static str, Problem> {
    let not_ready = |why: &str| {
        Problem::new(StatusCode::SERVICE_UNAVAILABLE, "not-ready", "The server cannot work").detail(why)
    };
    if app.stop.is_cancelled() {
        return Err(not_ready("it is shutting down"));
    }
    if !app.device.is_alive() {
        return Err(not_ready("the thread that renders has ended"));
    }
    app.store.ping().await.map_err(|error| {
        tracing::error!(%error, "the database does not answer");
        not_ready("the database does not answer")
    })?;
    app.store.artifacts().ping().await.map_err(|error| {
        tracing::error!(%error, "the object store does not answer");
        not_ready("the object store of artifacts does not answer").retry_after(10)
    })?;
    app.store.check_room().await.map_err(|error| {
        tracing::warn!(%error, "not ready");
        match error {
            StoreError::NoRoom { bytes } => {
                not_ready(&format!("the disk is full: there is no room for {bytes} more bytes"))
                    .retry_after(10)
            }
            error => not_ready(&format!("the data directory cannot be written: {error}")),
        }
    })?;
    Ok("ready\n")
}

/// Metrics for Prometheus
#[utoipa::path(get, path = "/metrics", tag = "operations", responses((status = 200, body = String)))]
async fn prometheus(State(app): State<Shared>) -> Result<Response, Problem> {
    let counts = app.store.job_counts().await?;
    for state in JobState::ALL {
        let count = counts.iter().find(|(s, _)| *s == state).map_or(0, |(_, n)| *n);
        metrics::gauge!("relume_jobs", "state" => state.name()).set(count as f64);
    }
    tell_of_workers(&app).await?;
    let text = observe::metrics_handle().render();
    Ok(([(header::CONTENT_TYPE, "text/plain; version=0.0.4")], text).into_response())
}

/// How the fleet stands, and how long the queue has been waiting for it.
async fn tell_of_workers(app: &Shared) -> Result<(), Problem> {
    let asked = Instant::now();
    app.store.ping().await?;
    metrics::gauge!("relume_database_ping_seconds").set(asked.elapsed().as_secs_f64());
    let alive = app.jobs.alive_ms();
    let workers = app.store.workers().await?;
    let states: Vec<WorkerState> = workers.into_iter().map(|worker| worker.view(alive).state).collect();
    for state in WorkerState::ALL {
        let count = states.iter().filter(|s| **s == state).count();
        metrics::gauge!("relume_workers", "state" => state.name()).set(count as f64);
    }
    let oldest = app.store.oldest_queued().await?;
    let waited_ms = oldest.map_or(0, |queued_ms| app.jobs.now_ms().saturating_sub(queued_ms).max(0));
    metrics::gauge!("relume_oldest_queued_job_seconds").set(waited_ms as f64 / 1000.0);
    Ok(())
}

/// Get this description
#[utoipa::path(get, path = "/v1/openapi.json", tag = "operations", responses((status = 200, body = Object)))]
async fn description(State(app): State<Shared>) -> Json<OpenApi> {
    Json(app.description.clone())
}
