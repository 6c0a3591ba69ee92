//! `/v1/jobs`: the queue of trainings.

use axum::Json;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use serde::Deserialize;
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::jobs::Origin;
use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::extract::{JsonBody, QueryString, UrlPath};
use crate::server::listing::PageQuery;
use crate::server::problem::Problem;
use crate::server::{capture_creation, idempotency, job_bounds, metadata, quality_gate, telemetry};
use crate::store::{CancelOutcome, IdempotencyKey, JobRecord, Submitted};
use relume_api::jobs::{JobChange, JobDevice, JobState, JobView, NewJob};
use relume_api::keys::Scope;
use relume_api::work::validate_labels;
use relume_api::{EnvironmentId, JobId, List, ResourceKind, TenantId};
use relume_capture::BUILTIN;
use relume_spec::training::{ConfigError, KnownLight, TrainConfig};

/// Path of jobs.
const JOBS: &str = "/v1/jobs";
const PRIORITIES: std::ops::RangeInclusive<i64> = -100..=100;

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(create_job, list_jobs))
        .routes(routes!(get_job, change_job))
        .routes(routes!(cancel_job))
        .routes(routes!(retry_job))
}

/// Filter and page of a list of jobs.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct JobQuery {
    /// Only jobs in this state.
    state: Option<JobState>,
    /// Only jobs with this name.
    #[param(min_length = 1, max_length = 200)]
    name: Option<String>,
    /// Only jobs with this external identifier.
    #[param(min_length = 1, max_length = 200)]
    external_id: Option<String>,
    /// Only jobs with this label, written `key:value`. Several labels are separated by commas; a job must
    /// have all of them.
    #[param(min_length = 3)]
    label: Option<String>,
    /// Maximum number of items, 1 to 200. Omitted: 50.
    #[param(minimum = 1, maximum = 200)]
    limit: Option<u32>,
    /// Cursor: the `next` of the previous page, or the identifier of an item. The page starts after that
    /// item. Omitted: the first page.
    #[param(min_length = 1)]
    before: Option<String>,
}

/// Queue a training
///
/// The server answers 202 when the job is durable. If the request has the header `Idempotency-Key`, the
/// server answers a repetition of the request within 24 hours with the first answer and the header
/// `Idempotent-Replayed: true`, and queues no second job.
///
/// On the CPU engine a job can have at most 200,000 Gaussians and a resolution of 4,096 pixels. At the end of
/// the training the worker compares the model with at most 8 held-out views of the capture. A job whose model
/// misses its `quality_gate` ends in the state `rejected` and keeps the model.
#[utoipa::path(
    post, path = "/v1/jobs", tag = "jobs", request_body = NewJob,
    params(
        ("Idempotency-Key" = Option<String>, Header, description = "Key of the request, 1 to 255 visible ASCII characters")
    ),
    responses(
        (status = 202, body = JobView),
        (status = 422, body = Problem, description = "A field is invalid, or the idempotency key was used with another body")
    )
)]
async fn create_job(
    State(app): State<AppState>,
    caller: Caller,
    headers: HeaderMap,
    JsonBody(job): JsonBody<NewJob>,
) -> Result<Response, Problem> {
    // A repeated request gets the first answer, even if the state has changed since.
    let key = idempotency::key(&headers, &job)?;
    if let Some(key) = &key
        && let Some(answer) = app.store.replayed(&caller.tenant, key, app.jobs.now_ms()).await?
    {
        return idempotency::accepted(answer, true, JOBS);
    }
    let config = TrainConfig::new(job.preset, &job.overrides).map_err(|e| override_refused(&e))?;
    if let Some((field, why)) = job.metadata().validation_error() {
        return Err(Problem::invalid_field(format!("/{field}"), why));
    }
    check_priority(&caller, job.priority)?;
    if let Some(why) = validate_labels(&job.requires) {
        return Err(Problem::invalid_field("/requires", why));
    }
    job_bounds::check(&config, on_gpu(&app, job.device).await?)?;
    let Some(capture) = app.store.capture(&caller.tenant, &job.capture).await? else {
        return Err(capture_creation::unavailable_reason(&app, &caller, &job.capture).await?);
    };
    quality_gate::check(&job.quality_gate, &capture.report, &config)?;
    if let Some(light) = &config.light {
        check_light(&app, &caller.tenant, light).await?;
    }
    submit(&app, &caller, job, i64::from(config.iterations), None, key.as_ref()).await
}

/// List jobs
///
/// Returns the jobs of the caller's tenant, newest first.
#[utoipa::path(
    get, path = "/v1/jobs", tag = "jobs", params(JobQuery),
    responses((status = 200, body = List<JobView>))
)]
async fn list_jobs(
    State(app): State<AppState>,
    caller: Caller,
    QueryString(query): QueryString<JobQuery>,
) -> Result<Json<List<JobView>>, Problem> {
    let filter = metadata::filter(query.name, query.external_id, query.label.as_deref())?;
    let page = PageQuery { limit: query.limit, before: query.before }
        .page(async |id| app.store.job(&caller.tenant, &id.into()).await)
        .await?;
    let jobs = app.jobs.list(&caller.tenant, query.state, &filter, &page.store_page()).await?;
    let (jobs, next) = page.cut(jobs);
    let positions = app.jobs.positions(&jobs).await?;
    let view = |job: JobRecord| {
        let position = positions.get(&job.id).copied();
        job.view(position)
    };
    Ok(Json(List { items: jobs.into_iter().map(view).collect(), next }))
}

/// Get a job
///
/// Returns state, progress and, after the end, figures and model of a job.
#[utoipa::path(
    get, path = "/v1/jobs/{id}", tag = "jobs", params(("id" = String, Path, description = "Job identifier")),
    responses((status = 200, body = JobView), (status = 404, body = Problem))
)]
async fn get_job(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<JobId>,
) -> Result<Json<JobView>, Problem> {
    current(&app, &caller.tenant, &id).await.map(Json)
}

/// Change a job
///
/// A JSON merge patch (RFC 7396). Omitted fields are unchanged; null clears a field. Name, external
/// identifier and labels can change in any state, the priority only in the state `queued`. The server does
/// not delete a job with the label `keep:true` because of its age.
#[utoipa::path(
    patch, path = "/v1/jobs/{id}", tag = "jobs",
    params(("id" = String, Path, description = "Job identifier")),
    request_body = JobChange,
    responses(
        (status = 200, body = JobView), (status = 404, body = Problem),
        (status = 409, body = Problem, description = "The priority cannot change because the job is not queued")
    )
)]
async fn change_job(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<JobId>,
    JsonBody(change): JsonBody<JobChange>,
) -> Result<Json<JobView>, Problem> {
    if let Some(priority) = change.priority {
        check_priority(&caller, priority)?;
        // This check comes before any change.
        must_wait(&current(&app, &caller.tenant, &id).await?)?;
    }
    metadata::change(&app, &caller.tenant, ResourceKind::Job, id.as_str(), &change.metadata()).await?;
    let moved = match change.priority {
        Some(priority) => app.jobs.set_priority(&caller.tenant, &id, priority).await?,
        None => true,
    };
    let job = current(&app, &caller.tenant, &id).await?;
    if !moved {
        must_wait(&job)?;
    }
    Ok(Json(job))
}

/// # Errors
/// 409 unless the job is queued.
fn must_wait(job: &JobView) -> Result<(), Problem> {
    if job.state == JobState::Queued {
        return Ok(());
    }
    let detail = format!("the job is {}; only the priority of a queued job can change", job.state.name());
    Err(Problem::conflict("job-not-queued", detail))
}

/// Cancel a job
///
/// A queued job becomes `cancelled` at once. A running job becomes `cancelling` and stops before its next
/// step. A repeated request has no effect.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/cancel", tag = "jobs", params(("id" = String, Path, description = "Job identifier")),
    responses(
        (status = 200, body = JobView), (status = 404, body = Problem),
        (status = 409, body = Problem, description = "The job is already in another final state")
    )
)]
async fn cancel_job(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<JobId>,
) -> Result<Json<JobView>, Problem> {
    match app.jobs.cancel(&caller.tenant, &id).await? {
        CancelOutcome::Accepted(job) => Ok(Json(job.view(None))),
        CancelOutcome::AlreadyFinished(job) => {
            let detail = format!("the job is already in the final state {}", job.state.name());
            Err(Problem::conflict("job-finished", detail))
        }
        CancelOutcome::NotFound => Err(Problem::not_found("job", id.as_str())),
    }
}

/// Retry a failed or cancelled job
///
/// Queues a new job with the same capture and settings. `retry_of` of the new job is the identifier of the
/// old job, which is unchanged. If the key lacks the scope `priority`, a priority above 0 becomes 0.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/retry", tag = "jobs", params(("id" = String, Path, description = "Job identifier")),
    responses(
        (status = 202, body = JobView), (status = 404, body = Problem),
        (status = 409, body = Problem, description = "The job is neither failed nor cancelled")
    )
)]
async fn retry_job(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<JobId>,
) -> Result<Response, Problem> {
    let job =
        app.store.job(&caller.tenant, &id).await?.ok_or_else(|| Problem::not_found("job", id.as_str()))?;
    if !matches!(job.state, JobState::Failed | JobState::Cancelled) {
        let detail =
            format!("the job is {}; only a failed or cancelled job can be retried", job.state.name());
        return Err(Problem::conflict("job-not-retryable", detail));
    }
    let mut request = job.request;
    if caller.require_scope(Scope::Priority).is_err() {
        request.priority = request.priority.min(0);
    }
    submit(&app, &caller, request, job.progress.total, Some(job.id), None).await
}

async fn submit(
    app: &AppState,
    caller: &Caller,
    request: NewJob,
    total: i64,
    retry_of: Option<JobId>,
    key: Option<&IdempotencyKey>,
) -> Result<Response, Problem> {
    // The training creates a model whose size is not known in advance.
    app.store.admit_bytes_of(&caller.tenant, 0).await?;
    let answer =
        |job: &JobRecord, position| serde_json::to_string(&job.clone().view(position)).unwrap_or_default();
    let origin = Origin { retry_of, traceparent: telemetry::traceparent() };
    let submitted = app.jobs.submit(&caller.tenant, request, total, origin, key, answer).await;
    let (text, replayed) = match submitted.map_err(|error| caller.problem_for(error))? {
        Submitted::Created(text) => (text, false),
        Submitted::Replayed(text) => (text, true),
    };
    idempotency::accepted(text, replayed, JOBS)
}

pub(super) async fn current(app: &AppState, tenant: &TenantId, id: &JobId) -> Result<JobView, Problem> {
    let found = app.jobs.get(tenant, id).await?;
    let (job, position) = found.ok_or_else(|| Problem::not_found("job", id.as_str()))?;
    Ok(job.view(position))
}

/// A known light must exist for the worker.
async fn check_light(app: &AppState, tenant: &TenantId, light: &KnownLight) -> Result<(), Problem> {
    let name = light.environment.as_str();
    if BUILTIN.contains(&name) || app.store.environment(tenant, &EnvironmentId::from(name)).await?.is_some() {
        return Ok(());
    }
    let detail = format!(
        "{name:?} is neither the identifier of an uploaded environment map nor one of {}",
        BUILTIN.join(", ")
    );
    Err(Problem::invalid_field("/overrides/light/environment", detail))
}

/// Whether a job may train on a GPU of this server or of a worker. If only remote workers train, they may start later.
///
/// # Errors
/// 422 if the job requires a GPU and there is none.
async fn on_gpu(app: &AppState, asked: JobDevice) -> Result<bool, Problem> {
    let there = app.device.has_gpu()
        || !app.trains
        || app.store.has_gpu_worker(app.jobs.heartbeat_cutoff_ms()).await?;
    if asked == JobDevice::Gpu && !there {
        return Err(Problem::invalid_field("/device", "neither this server nor a worker has a GPU"));
    }
    Ok(asked != JobDevice::Cpu && there)
}

/// Any submitter may lower the priority; a priority above 0, which affects other tenants, requires a scope.
fn check_priority(caller: &Caller, priority: i64) -> Result<(), Problem> {
    if !PRIORITIES.contains(&priority) {
        return Err(Problem::invalid_field("/priority", format!("must be -100 to 100, got {priority}")));
    }
    if priority > 0 { caller.require_scope(Scope::Priority) } else { Ok(()) }
}

/// The problem of an invalid override. Its pointer names the setting, within its group if it has one.
fn override_refused(error: &ConfigError) -> Problem {
    // The rest may be the name of a photograph, which contains dots.
    let (first, rest) = error.field.split_once('.').map_or((&*error.field, None), |(a, b)| (a, Some(b)));
    let rest = rest.map(|rest| format!("/{}", rest.replace('~', "~0").replace('/', "~1")));
    let pointer = format!("/overrides/{first}{}", rest.unwrap_or_default());
    Problem::invalid_field(pointer, error.to_string())
}
