//! `/healthz`, `/readyz`, `/metrics` and the description of the API.

use std::time::Instant;

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use utoipa::openapi::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::problem::Problem;
use crate::server::telemetry;
use crate::store::StoreError;
use relume_api::jobs::JobState;
use relume_api::work::WorkerState;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(healthz))
        .routes(routes!(readyz))
        .routes(routes!(prometheus))
        .routes(routes!(description))
}

/// Check that the process runs
///
/// Liveness probe. Always answers 200.
#[utoipa::path(get, path = "/healthz", tag = "operations", responses((status = 200, body = String)))]
async fn healthz() -> &'static str {
    "ok\n"
}

/// Check that the server is ready
///
/// Readiness probe. Checks the render thread, the database, the object store, the disk space and the data
/// directory.
#[utoipa::path(
    get, path = "/readyz", tag = "operations",
    responses(
        (status = 200, body = String),
        (status = 503, body = Problem, description = "Not ready; `detail` has the reason, e.g. a full disk or a shutdown")
    )
)]
async fn readyz(State(app): State<AppState>) -> Result<&'static str, Problem> {
    let not_ready = |why: &str| {
        Problem::new(StatusCode::SERVICE_UNAVAILABLE, "not-ready", "The server is not ready").detail(why)
    };
    if app.stop.is_cancelled() {
        return Err(not_ready("the server is shutting down"));
    }
    if !app.device.is_alive() {
        return Err(not_ready("the render thread has ended"));
    }
    app.store.ping().await.map_err(|error| {
        tracing::error!(%error, "the database does not answer");
        not_ready("the database does not answer")
    })?;
    app.store.artifacts().ping().await.map_err(|error| {
        tracing::error!(%error, "the object store does not answer");
        not_ready("the object store does not answer").retry_after(10)
    })?;
    app.store.check_disk_space().await.map_err(|error| {
        tracing::warn!(%error, "not ready");
        match error {
            StoreError::NoDiskSpace { bytes } => {
                not_ready(&format!("the disk is full: {bytes} more bytes do not fit")).retry_after(10)
            }
            error => not_ready(&format!("the data directory cannot be written: {error}")),
        }
    })?;
    Ok("ready\n")
}

/// Get metrics
///
/// Metrics in the Prometheus text format. Requires a key of the tenant `default` with the scope `metrics` or
/// `admin`.
#[utoipa::path(get, path = "/metrics", tag = "operations", responses((status = 200, body = String)))]
async fn prometheus(State(app): State<AppState>) -> Result<Response, Problem> {
    let counts = app.store.job_counts().await?;
    for state in JobState::ALL {
        let count = counts.iter().find(|(s, _)| *s == state).map_or(0, |(_, n)| *n);
        metrics::gauge!("relume_jobs", "state" => state.name()).set(count as f64);
    }
    record_worker_metrics(&app).await?;
    let text = telemetry::metrics_handle().render();
    Ok(([(header::CONTENT_TYPE, "text/plain; version=0.0.4")], text).into_response())
}

/// Records the states of the workers and the waiting time of the oldest queued job.
async fn record_worker_metrics(app: &AppState) -> Result<(), Problem> {
    let asked = Instant::now();
    app.store.ping().await?;
    metrics::gauge!("relume_database_ping_seconds").set(asked.elapsed().as_secs_f64());
    let alive = app.jobs.heartbeat_cutoff_ms();
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

/// Get the API description
///
/// Returns this OpenAPI document.
#[utoipa::path(get, path = "/v1/openapi.json", tag = "operations", responses((status = 200, body = Object)))]
async fn description(State(app): State<AppState>) -> Json<OpenApi> {
    Json(app.description.clone())
}
