//! Small requests of workers: claims, heartbeats, progress, warnings, and the end of an attempt.

use axum::Json;
use axum::extract::State;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::extract::JsonBody;
use crate::server::problem::Problem;
use crate::server::workers::lease::{Held, lease_view};
use crate::server::workers::results::check_name;
use crate::store::{Claimant, LeaseStatus, StoreError};
use relume_api::JobId;
use relume_api::jobs::JobProgress;
use relume_api::work::{
    Claimed, FinishedModel, LeaseView, WorkEnd, WorkWarning, WorkerHello, validate_labels,
};

/// Maximum length of a warning, characters.
const MAX_WARNING_CHARS: usize = 2000;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(claim_job))
        .routes(routes!(beat))
        .routes(routes!(report_progress))
        .routes(routes!(report_warning))
        .routes(routes!(publish_model))
        .routes(routes!(end_attempt))
}

/// Claim a job
///
/// For workers. The request is also the heartbeat of a worker without a job. The answer has no `task` if
/// there is no job for this worker. A worker with a job must send heartbeats at the interval `beat_ms`. After
/// a minute without one, the server gives the job to another worker.
#[utoipa::path(
    post, path = "/v1/work/claims", tag = "workers", request_body = WorkerHello,
    responses((status = 200, body = Claimed), (status = 422, body = Problem))
)]
async fn claim_job(
    State(app): State<AppState>,
    JsonBody(hello): JsonBody<WorkerHello>,
) -> Result<Json<Claimed>, Problem> {
    check(&hello)?;
    let draining = app.jobs.record_worker_heartbeat(&hello, None).await?;
    let beat_ms = app.jobs.heartbeat_interval_ms();
    if draining || app.stop.is_cancelled() || app.store.check_disk_space().await.is_err() {
        return Ok(Json(Claimed { task: None, lease: None, draining, beat_ms }));
    }
    let claimant = Claimant { worker: Some(hello.id), has_gpu: hello.has_gpu, labels: hello.labels };
    let lease = app.jobs.claim_as(&claimant).await?;
    Ok(Json(Claimed {
        task: lease.as_ref().map(|lease| lease.task()),
        lease: lease.as_ref().map(|lease| lease.token().to_owned()),
        draining,
        beat_ms,
    }))
}

/// # Errors
/// Names the invalid field.
fn check(hello: &WorkerHello) -> Result<(), Problem> {
    let wrong = |field: &str, why: &str| Err(Problem::invalid_field(format!("/{field}"), why));
    let id = hello.id.as_str();
    if !(8..=64).contains(&id.len()) || !id.chars().all(|c| c.is_ascii_alphanumeric() || c == '-') {
        return wrong("id", "must have 8 to 64 characters of A-Z, a-z, 0-9 and `-`");
    }
    for (field, text) in [("name", &hello.name), ("device", &hello.device), ("version", &hello.version)] {
        let length = text.chars().count();
        if !(1..=200).contains(&length) || text.chars().any(char::is_control) {
            return wrong(field, "must have 1 to 200 characters without control characters");
        }
    }
    // Another version may not support the settings of a job, and produces other bytes.
    let version = env!("CARGO_PKG_VERSION");
    if hello.version != version {
        let why = format!("must be {version}, the version of the server; got {}", hello.version);
        return wrong("version", &why);
    }
    match validate_labels(&hello.labels) {
        Some(why) => wrong("labels", &why),
        None => Ok(()),
    }
}

/// Send a heartbeat
///
/// For workers with a job, at the interval `beat_ms` of the claim. The answer contains the status of the
/// lease, e.g. that the job must stop, and whether another job should run first. A heartbeat does not renew the lease; a progress report does.
#[utoipa::path(
    post, path = "/v1/work/{job}/heartbeat", tag = "workers",
    params(
        ("job" = String, Path, description = "Job identifier"),
        ("Relume-Lease" = String, Header, description = "Lease token of the job")
    ),
    responses((status = 200, body = LeaseView), (status = 409, body = Problem, description = "The lease is no longer valid"))
)]
async fn beat(State(app): State<AppState>, Held(lease): Held) -> Result<Json<LeaseView>, Problem> {
    let job: &JobId = &lease.job().id;
    app.store.record_lease_heartbeat(job, lease.token(), app.jobs.now_ms()).await?;
    let view = lease_view(lease.check().await)?;
    Ok(Json(LeaseView { should_yield: lease.should_yield().await?, ..view }))
}

/// Report progress
///
/// For workers. Renews the lease. A worker must send it only after a completed step.
#[utoipa::path(
    post, path = "/v1/work/{job}/progress", tag = "workers", request_body = JobProgress,
    params(
        ("job" = String, Path, description = "Job identifier"),
        ("Relume-Lease" = String, Header, description = "Lease token of the job")
    ),
    responses((status = 200, body = LeaseView), (status = 409, body = Problem, description = "The lease is no longer valid"))
)]
async fn report_progress(
    State(app): State<AppState>,
    Held(lease): Held,
    JsonBody(progress): JsonBody<JobProgress>,
) -> Result<Json<LeaseView>, Problem> {
    app.store.record_lease_heartbeat(&lease.job().id, lease.token(), app.jobs.now_ms()).await?;
    let steps = progress.step.saturating_sub(lease.job().progress.step);
    metrics::counter!("relume_training_steps_total").increment(u64::try_from(steps).unwrap_or(0));
    lease_view(lease.progress(&progress).await).map(Json)
}

/// Report a warning
///
/// For workers. Adds a `warning` event to the job.
#[utoipa::path(
    post, path = "/v1/work/{job}/warnings", tag = "workers", request_body = WorkWarning,
    params(
        ("job" = String, Path, description = "Job identifier"),
        ("Relume-Lease" = String, Header, description = "Lease token of the job")
    ),
    responses((status = 200, body = LeaseView), (status = 409, body = Problem, description = "The lease is no longer valid"))
)]
async fn report_warning(
    Held(lease): Held,
    JsonBody(warning): JsonBody<WorkWarning>,
) -> Result<Json<LeaseView>, Problem> {
    let text: String = warning.message.chars().take(MAX_WARNING_CHARS).collect();
    lease_view(lease.warn(&text).await).map(Json)
}

/// Publish a model
///
/// For workers. The worker must have sent the files before. In one transaction the server publishes the model
/// and sets the job to `succeeded` or `rejected`.
#[utoipa::path(
    post, path = "/v1/work/{job}/model", tag = "workers", request_body = FinishedModel,
    params(
        ("job" = String, Path, description = "Job identifier"),
        ("Relume-Lease" = String, Header, description = "Lease token of the job")
    ),
    responses(
        (status = 200, body = LeaseView),
        (status = 409, body = Problem, description = "The lease is no longer valid"),
        (status = 422, body = Problem, description = "A file does not match a sent file")
    )
)]
async fn publish_model(
    Held(lease): Held,
    JsonBody(model): JsonBody<FinishedModel>,
) -> Result<Json<LeaseView>, Problem> {
    for (i, file) in model.files.iter().enumerate() {
        check_name(&file.name, &format!("/files/{i}/name"))?;
        lease.verify_file(file).await.map_err(|error| match error {
            StoreError::Damaged(_) | StoreError::Missing(_) => {
                Problem::invalid_field(format!("/files/{i}"), "does not match a file that the worker sent")
            }
            error => error.into(),
        })?;
    }
    lease_view(lease.finish(model).await).map(Json)
}

/// End an attempt without a model
///
/// For workers. The job returns to the queue, fails, or is cancelled as requested.
#[utoipa::path(
    post, path = "/v1/work/{job}/end", tag = "workers", request_body = WorkEnd,
    params(
        ("job" = String, Path, description = "Job identifier"),
        ("Relume-Lease" = String, Header, description = "Lease token of the job")
    ),
    responses((status = 200, body = LeaseView), (status = 409, body = Problem, description = "The lease is no longer valid"))
)]
async fn end_attempt(
    Held(lease): Held,
    JsonBody(end): JsonBody<WorkEnd>,
) -> Result<Json<LeaseView>, Problem> {
    let status = match end {
        WorkEnd::Released { why } => lease.release(why).await,
        WorkEnd::Failed { code, detail } => lease.fail(&code, &detail).await,
        WorkEnd::Cancelled => lease.confirm_cancel().await,
    };
    // A job that was asked to stop in the meantime cannot be released; the worker must query the lease again.
    match status {
        Ok(LeaseStatus::Lost) => lease_view(lease.check().await).map(Json),
        status => lease_view(status).map(Json),
    }
}
