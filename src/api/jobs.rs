//! `/v1/jobs`: trainings, queued and run one after another.

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::extract::{JsonBody, QueryString};
use crate::api::listing::{List, page, rfc3339};
use crate::api::{Problem, Shared};
use crate::capture::BUILTIN;
use crate::jobs::JobOrder;
use crate::store::{Cancelled, IdempotencyKey, JobRecord, JobState, Submitted, hex};
use crate::train::{ConfigError, KnownLight, Preset, TrainConfig, TrainOverrides};

const IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");
const REPLAYED: HeaderName = HeaderName::from_static("idempotent-replayed");
const PRIORITIES: std::ops::RangeInclusive<i64> = -100..=100;

/// The routes of this family.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(create_job, list_jobs))
        .routes(routes!(get_job, change_job))
        .routes(routes!(cancel_job))
        .routes(routes!(retry_job))
}

/// What to train.
#[derive(Debug, Clone, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewJob {
    /// Identifier of the capture.
    pub capture: String,
    /// `draft`, `standard` (the default) or `high`.
    #[serde(default)]
    pub preset: Preset,
    /// Changes on top of the preset, e.g. `{"resolution": 200}`; `{"light": {"environment": "ID"}}` holds a known light.
    #[serde(default)]
    pub overrides: TrainOverrides,
    /// -100 to 100; higher runs first.
    #[serde(default)]
    pub priority: i64,
    /// `auto`, `cpu` or `gpu`.
    #[serde(default)]
    pub device: DeviceChoice,
}

/// Where to train.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DeviceChoice {
    /// The device of the server.
    #[default]
    Auto,
    /// The CPU engine.
    Cpu,
    /// A GPU; refused where the server has none.
    Gpu,
}

impl DeviceChoice {
    fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Cpu => "cpu",
            Self::Gpu => "gpu",
        }
    }
}

/// What may be changed about a waiting job.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JobChange {
    /// -100 to 100; higher runs first.
    pub priority: i64,
}

/// A job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct JobView {
    /// Identifier.
    pub id: String,
    /// Identifier of the capture.
    pub capture: String,
    /// The job that this one repeats.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub retry_of: Option<String>,
    /// Preset.
    #[schema(value_type = Preset)]
    pub preset: String,
    /// Changes on top of the preset.
    #[schema(value_type = TrainOverrides)]
    pub overrides: serde_json::Value,
    /// Where it trains.
    pub device: String,
    /// Higher runs first.
    pub priority: i64,
    /// Where it stands.
    pub state: JobState,
    /// Jobs that run before this one, while it is queued.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub queue_position: Option<i64>,
    /// How far it is.
    pub progress: JobProgress,
    /// Times a worker took it up.
    pub attempts: i64,
    /// RFC 3339.
    pub created_at: String,
    /// RFC 3339; when it was first taken up.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub started_at: Option<String>,
    /// RFC 3339; when it ended.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub finished_at: Option<String>,
    /// Identifier of the model, once it succeeded.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub model: Option<String>,
    /// Why it failed.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub error: Option<JobError>,
}

/// How far a job is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct JobProgress {
    /// Steps done.
    pub step: i64,
    /// Steps in all.
    pub total: i64,
    /// The objective.
    pub loss: Option<f64>,
    /// PSNR of the last step's view, dB.
    pub psnr: Option<f64>,
    /// Gaussians now.
    pub gaussians: Option<i64>,
    /// Expected time to the end.
    pub eta_seconds: Option<f64>,
    /// What the worker is doing.
    pub message: Option<String>,
}

/// Why a job failed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct JobError {
    /// Stable code, e.g. `training_failed`, `attempts_exhausted`.
    pub code: String,
    /// For people.
    pub detail: String,
}

/// Which jobs to list.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct JobQuery {
    /// Only jobs in this state.
    state: Option<JobState>,
    /// Most items, 1 to 200; 50 when absent.
    limit: Option<u32>,
    /// Only items older than this identifier.
    before: Option<String>,
}

/// Queue a training
///
/// With an `Idempotency-Key` header, a repetition of the same request within 24 hours is answered with the first
/// answer (and the header `Idempotent-Replayed: true`) and queues nothing. 202 means that the job is durable.
#[utoipa::path(
    post, path = "/v1/jobs", tag = "jobs", request_body = NewJob,
    params(("Idempotency-Key" = Option<String>, Header, description = "1 to 255 visible characters")),
    responses(
        (status = 202, body = JobView),
        (status = 422, body = Problem, description = "A field is wrong, or the key came with another body")
    )
)]
async fn create_job(
    State(app): State<Shared>,
    headers: HeaderMap,
    JsonBody(job): JsonBody<NewJob>,
) -> Result<Response, Problem> {
    let config = TrainConfig::new(job.preset, &job.overrides).map_err(|e| override_refused(&e))?;
    check_priority(job.priority)?;
    if job.device == DeviceChoice::Gpu && !app.device.has_gpu() {
        return Err(Problem::invalid_field("/device", "this server has no GPU"));
    }
    if app.store.capture(&job.capture).await?.is_none() {
        return Err(Problem::invalid_field("/capture", format!("{:?} does not exist", job.capture)));
    }
    if let Some(light) = &config.light {
        check_light(&app, light).await?;
    }
    let key = idempotency_key(&headers, &job)?;
    let order = JobOrder {
        capture_id: job.capture,
        retry_of: None,
        preset: preset_name(job.preset)?,
        overrides: serde_json::to_string(&job.overrides).map_err(Problem::internal)?,
        device: job.device.name().to_owned(),
        priority: job.priority,
        total: i64::from(config.iterations),
    };
    submit(&app, order, key.as_ref()).await
}

/// List jobs
#[utoipa::path(
    get, path = "/v1/jobs", tag = "jobs", params(JobQuery),
    responses((status = 200, body = List<JobView>))
)]
async fn list_jobs(
    State(app): State<Shared>,
    QueryString(query): QueryString<JobQuery>,
) -> Result<Json<List<JobView>>, Problem> {
    let page = page(query.limit, query.before)?;
    let mut items = Vec::new();
    for job in app.jobs.list(query.state, &page).await? {
        let position = match job.state {
            JobState::Queued => app.store.queue_position(&job.id).await?,
            _ => None,
        };
        items.push(view(&job, position));
    }
    Ok(Json(List::new(items, &page, |j: &JobView| &j.id)))
}

/// Look at a job
#[utoipa::path(
    get, path = "/v1/jobs/{id}", tag = "jobs", params(("id" = String, Path)),
    responses((status = 200, body = JobView), (status = 404, body = Problem))
)]
async fn get_job(State(app): State<Shared>, Path(id): Path<String>) -> Result<Json<JobView>, Problem> {
    current(&app, &id).await.map(Json)
}

/// Change the priority of a waiting job
#[utoipa::path(
    patch, path = "/v1/jobs/{id}", tag = "jobs", params(("id" = String, Path)), request_body = JobChange,
    responses(
        (status = 200, body = JobView), (status = 404, body = Problem),
        (status = 409, body = Problem, description = "It does not wait any more")
    )
)]
async fn change_job(
    State(app): State<Shared>,
    Path(id): Path<String>,
    JsonBody(change): JsonBody<JobChange>,
) -> Result<Json<JobView>, Problem> {
    check_priority(change.priority)?;
    let changed = app.jobs.set_priority(&id, change.priority).await?;
    let job = current(&app, &id).await?;
    if !changed {
        let detail = format!("the job is {}; only a queued one has a place in the queue", job.state.name());
        return Err(Problem::conflict("job-not-queued", detail));
    }
    Ok(Json(job))
}

/// Cancel a job
///
/// A queued job is cancelled at once; a running one becomes `cancelling` and stops before its next step. Asking
/// again changes nothing.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/cancel", tag = "jobs", params(("id" = String, Path)),
    responses(
        (status = 200, body = JobView), (status = 404, body = Problem),
        (status = 409, body = Problem, description = "It succeeded or failed before")
    )
)]
async fn cancel_job(State(app): State<Shared>, Path(id): Path<String>) -> Result<Json<JobView>, Problem> {
    match app.jobs.cancel(&id).await? {
        Cancelled::Accepted(job) => Ok(Json(view(&job, None))),
        Cancelled::AlreadyFinished(job) => {
            let detail = format!("the job has {}; terminal states never change", job.state.name());
            Err(Problem::conflict("job-finished", detail))
        }
        Cancelled::NotFound => Err(Problem::not_found("job", &id)),
    }
}

/// Run a failed or cancelled job again
///
/// Queues a new job with the same capture and settings; `retry_of` names the old one, which stays as it is.
#[utoipa::path(
    post, path = "/v1/jobs/{id}/retry", tag = "jobs", params(("id" = String, Path)),
    responses(
        (status = 202, body = JobView), (status = 404, body = Problem),
        (status = 409, body = Problem, description = "It neither failed nor was cancelled")
    )
)]
async fn retry_job(State(app): State<Shared>, Path(id): Path<String>) -> Result<Response, Problem> {
    let job = app.store.job(&id).await?.ok_or_else(|| Problem::not_found("job", &id))?;
    if !matches!(job.state, JobState::Failed | JobState::Cancelled) {
        let detail = format!("the job is {}; only a failed or cancelled one runs again", job.state.name());
        return Err(Problem::conflict("job-not-retryable", detail));
    }
    let order = JobOrder {
        capture_id: job.capture_id,
        retry_of: Some(job.id),
        preset: job.preset,
        overrides: job.overrides,
        device: job.device,
        priority: job.priority,
        total: job.total,
    };
    submit(&app, order, None).await
}

async fn submit(app: &Shared, order: JobOrder, key: Option<&IdempotencyKey>) -> Result<Response, Problem> {
    let answer = |job: &JobRecord, position| serde_json::to_string(&view(job, position)).unwrap_or_default();
    let submitted = app.jobs.submit(order, key, answer).await?;
    let (text, replayed) = match submitted {
        Submitted::Created(text) => (text, false),
        Submitted::Replayed(text) => (text, true),
    };
    let json = HeaderValue::from_static("application/json");
    let mut response = (StatusCode::ACCEPTED, [(header::CONTENT_TYPE, json)], text).into_response();
    if replayed {
        response.headers_mut().insert(REPLAYED, HeaderValue::from_static("true"));
    }
    Ok(response)
}

async fn current(app: &Shared, id: &str) -> Result<JobView, Problem> {
    let found = app.jobs.get(id).await?;
    let (job, position) = found.ok_or_else(|| Problem::not_found("job", id))?;
    Ok(view(&job, position))
}

/// The key with a hash of what the request means, so that white space does not make another request of it.
fn idempotency_key(headers: &HeaderMap, job: &NewJob) -> Result<Option<IdempotencyKey>, Problem> {
    let Some(value) = headers.get(IDEMPOTENCY_KEY) else { return Ok(None) };
    let key = value.to_str().ok().filter(|k| (1..=255).contains(&k.len()));
    let wrong = || Problem::invalid_field("header/Idempotency-Key", "must have 1 to 255 visible characters");
    let body = serde_json::to_vec(job).map_err(Problem::internal)?;
    Ok(Some(IdempotencyKey {
        key: key.ok_or_else(wrong)?.to_owned(),
        fingerprint: hex(&Sha256::digest(&body)),
    }))
}

/// A known light must be one that the worker will find.
async fn check_light(app: &Shared, light: &KnownLight) -> Result<(), Problem> {
    let name = light.environment.as_str();
    if BUILTIN.contains(&name) || app.store.environment(name).await?.is_some() {
        return Ok(());
    }
    let detail = format!("{name:?} is no uploaded environment and none of {}", BUILTIN.join(", "));
    Err(Problem::invalid_field("/overrides/light/environment", detail))
}

fn check_priority(priority: i64) -> Result<(), Problem> {
    if PRIORITIES.contains(&priority) {
        return Ok(());
    }
    Err(Problem::invalid_field("/priority", format!("must be -100 to 100, got {priority}")))
}

fn override_refused(error: &ConfigError) -> Problem {
    let setting = error.field.split('.').next().unwrap_or_default();
    Problem::invalid_field(format!("/overrides/{setting}"), error.to_string())
}

fn preset_name(preset: Preset) -> Result<String, Problem> {
    serde_json::to_value(preset)
        .ok()
        .and_then(|v| v.as_str().map(str::to_owned))
        .ok_or_else(|| Problem::internal("a preset without a name"))
}

fn view(job: &JobRecord, queue_position: Option<i64>) -> JobView {
    let error = job
        .error_code
        .clone()
        .map(|code| JobError { code, detail: job.error_detail.clone().unwrap_or_default() });
    JobView {
        id: job.id.clone(),
        capture: job.capture_id.clone(),
        retry_of: job.retry_of.clone(),
        preset: job.preset.clone(),
        overrides: overrides(&job.overrides),
        device: job.device.clone(),
        priority: job.priority,
        state: job.state,
        queue_position,
        progress: JobProgress {
            step: job.step,
            total: job.total,
            loss: job.loss,
            psnr: job.psnr,
            gaussians: job.gaussians,
            eta_seconds: job.eta_seconds,
            message: job.message.clone(),
        },
        attempts: job.attempts,
        created_at: rfc3339(job.created_ms),
        started_at: job.started_ms.map(rfc3339),
        finished_at: job.finished_ms.map(rfc3339),
        model: job.model_id.clone(),
        error,
    }
}

/// The overrides that were given: absent ones are stored as nulls and not worth showing.
fn overrides(stored: &str) -> serde_json::Value {
    let mut value: serde_json::Value = serde_json::from_str(stored).unwrap_or_default();
    if let Some(fields) = value.as_object_mut() {
        fields.retain(|_, v| !v.is_null());
    }
    value
}
