//! What workers ask for and report in small messages: a job, that they are there, progress, warnings, the end.

use axum::Json;
use axum::extract::State;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::jobs::JobProgress;
use crate::api::work::{
    Claimed, FinishedModel, LeaseView, WorkEnd, WorkWarning, WorkerHello, fault_of_labels,
};
use crate::api::{JobId, Problem};
use crate::server::app::Shared;
use crate::server::extract::JsonBody;
use crate::server::workers::lease::{Held, standing};
use crate::server::workers::results::check_name;
use crate::store::{Claimant, LeaseStatus, StoreError};

/// Longest warning, characters.
const LONGEST_WARNING: usize = 2000;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<Shared> {
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
/// For workers. Counts as a sign of life of one that has no job. The answer is empty when no job waits that this worker may have.
/// Whoever gets one reports every few seconds; after a minute of silence the job is given to another.
#[utoipa::path(
    post, path = "/v1/work/claims", tag = "workers", request_body = WorkerHello,
    responses((status = 200, body = Claimed), (status = 422, body = Problem))
)]
async fn claim_job(
    State(app): State<Shared>,
    JsonBody(hello): JsonBody<WorkerHello>,
) -> Result<Json<Claimed>, Problem> {
    check(&hello)?;
    let draining = app.jobs.note_worker(&hello, None).await?;
    let beat_ms = app.jobs.beat_ms();
    if draining || app.stop.is_cancelled() || app.store.check_room().await.is_err() {
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
/// Names the field that is wrong.
fn check(hello: &WorkerHello) -> Result<(), Problem> {
    let wrong = |field: &str, why: &str| Err(Problem::invalid_field(format!("/{field}"), why));
    let id = hello.id.as_str();
    if !(8..=64).contains(&id.len()) || !id.chars().all(|c| c.is_ascii_alphanumeric() || c == '-') {
        return wrong("id", "must have 8 to 64 of A-Z, a-z, 0-9 and `-`");
    }
    for (field, text) in [("name", &hello.name), ("device", &hello.device), ("version", &hello.version)] {
        let length = text.chars().count();
        if !(1..=200).contains(&length) || text.chars().any(char::is_control) {
            return wrong(field, "must have 1 to 200 characters, none of them control characters");
        }
    }
    // Another version may not know what a job asks for, and makes other bytes.
    let version = env!("CARGO_PKG_VERSION");
    if hello.version != version {
        let why =
            format!("this server gives jobs to workers of version {version}, this one has {}", hello.version);
        return wrong("version", &why);
    }
    match fault_of_labels(&hello.labels) {
        Some(why) => wrong("labels", &why),
        None => Ok(()),
    }
}

/// Say that a worker is there
///
/// For workers that have a job, every few seconds; tells whether the job shall stop. Does not renew the lease: progress does.
#[utoipa::path(
    post, path = "/v1/work/{job}/heartbeat", tag = "workers",
    params(("job" = String, Path), ("Relume-Lease" = String, Header)),
    responses((status = 200, body = LeaseView), (status = 409, body = Problem, description = "The lease is lost"))
)]
async fn beat(State(app): State<Shared>, Held(lease): Held) -> Result<Json<LeaseView>, Problem> {
    let job: &JobId = &lease.job().id;
    app.store.see_worker_of(job, lease.token(), app.jobs.now_ms()).await?;
    standing(lease.check().await).map(Json)
}

/// Report progress
///
/// For workers. Renews the lease: to be sent when a step was done and at no other time.
#[utoipa::path(
    post, path = "/v1/work/{job}/progress", tag = "workers", request_body = JobProgress,
    params(("job" = String, Path), ("Relume-Lease" = String, Header)),
    responses((status = 200, body = LeaseView), (status = 409, body = Problem, description = "The lease is lost"))
)]
async fn report_progress(
    State(app): State<Shared>,
    Held(lease): Held,
    JsonBody(progress): JsonBody<JobProgress>,
) -> Result<Json<LeaseView>, Problem> {
    app.store.see_worker_of(&lease.job().id, lease.token(), app.jobs.now_ms()).await?;
    let steps = progress.step.saturating_sub(lease.job().progress.step);
    metrics::counter!("relume_training_steps_total").increment(u64::try_from(steps).unwrap_or(0));
    standing(lease.progress(&progress).await).map(Json)
}

/// Warn the user
///
/// For workers: an event in the job's history.
#[utoipa::path(
    post, path = "/v1/work/{job}/warnings", tag = "workers", request_body = WorkWarning,
    params(("job" = String, Path), ("Relume-Lease" = String, Header)),
    responses((status = 200, body = LeaseView), (status = 409, body = Problem, description = "The lease is lost"))
)]
async fn report_warning(
    Held(lease): Held,
    JsonBody(warning): JsonBody<WorkWarning>,
) -> Result<Json<LeaseView>, Problem> {
    let text: String = warning.message.chars().take(LONGEST_WARNING).collect();
    standing(lease.warn(&text).await).map(Json)
}

/// Publish a model
///
/// For workers: the files were sent before. Publishes the model and ends the job as succeeded or rejected, in one transaction.
#[utoipa::path(
    post, path = "/v1/work/{job}/model", tag = "workers", request_body = FinishedModel,
    params(("job" = String, Path), ("Relume-Lease" = String, Header)),
    responses(
        (status = 200, body = LeaseView), (status = 409, body = Problem, description = "The lease is lost"),
        (status = 422, body = Problem, description = "A file is not as it was sent")
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
                Problem::invalid_field(format!("/files/{i}"), "no such file with these bytes was sent before")
            }
            error => error.into(),
        })?;
    }
    standing(lease.finish(model).await).map(Json)
}

/// End an attempt without a model
///
/// For workers: the job goes back to the queue, has failed, or was cancelled as it was asked to be.
#[utoipa::path(
    post, path = "/v1/work/{job}/end", tag = "workers", request_body = WorkEnd,
    params(("job" = String, Path), ("Relume-Lease" = String, Header)),
    responses((status = 200, body = LeaseView), (status = 409, body = Problem, description = "The lease is lost"))
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
    // What was asked to stop meanwhile cannot be released: the worker asks again how it stands.
    match status {
        Ok(LeaseStatus::Lost) => standing(lease.check().await).map(Json),
        status => standing(status).map(Json),
    }
}
