//! `/v1/jobs/{id}/events`: past and new events of a job, as server-sent events.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::time::Duration;

use axum::extract::State;
use axum::http::{HeaderMap, HeaderName};
use axum::response::sse::{Event, KeepAlive};
use axum::response::{IntoResponse, Sse};
use serde::Deserialize;
use tokio::sync::watch;
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::extract::{QueryString, UrlPath};
use crate::server::listing::rfc3339;
use crate::server::problem::Problem;
use crate::server::signing_secret::digest;
use crate::store::{EventRecord, StoreError};
use relume_api::{JobId, KeyId, TenantId};

/// Time for which a listener waits for a notification before it queries the database.
const POLL: Duration = Duration::from_secs(5);
/// Interval of comments that keep idle connections open. Proxies close a connection that is idle for a minute or more.
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// Makes proxies that know the header (nginx) pass each event on at once. axum adds `Cache-Control: no-cache`.
const UNBUFFERED: [(HeaderName, &str); 1] = [(HeaderName::from_static("x-accel-buffering"), "no")];

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new().routes(routes!(job_events))
}

/// Start of the stream.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct EventQuery {
    /// Number of an event. The stream starts after it. `Last-Event-ID` takes precedence. Omitted: from the
    /// first event.
    after: Option<i64>,
}

/// Stream the events of a job
///
/// Server-sent events: all events after `Last-Event-ID`, or from the beginning, then new events as they
/// happen. The stream ends when the job is in a final state, when the caller's key or signed URL expires or
/// is revoked, or when the operator replaces the signing secret.
///
/// Event types: `state`, `progress`, `checkpoint` and `warning`. The data is a JSON object with the time
/// `at`, RFC 3339. Event numbers increase, also across restarts of the server. The last `state` event of a
/// job with a model contains its `figures`.
#[utoipa::path(
    get, path = "/v1/jobs/{id}/events", tag = "jobs",
    params(
        ("id" = String, Path, description = "Job identifier"),
        EventQuery,
        ("Last-Event-ID" = Option<i64>, Header, description = "Number of the last received event")
    ),
    responses(
        (status = 200, content_type = "text/event-stream", body = String), (status = 404, body = Problem)
    )
)]
async fn job_events(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<JobId>,
    QueryString(query): QueryString<EventQuery>,
    headers: HeaderMap,
) -> Result<impl IntoResponse, Problem> {
    if app.store.job(&caller.tenant, &id).await?.is_none() {
        return Err(Problem::not_found("job", id.as_str()));
    }
    let after = match headers.get("last-event-id") {
        None => query.after.unwrap_or(0),
        Some(value) => value.to_str().ok().and_then(|v| v.trim().parse().ok()).ok_or_else(|| {
            Problem::invalid_field("header/Last-Event-ID", "must be a number from an earlier event")
        })?,
    };
    let changes = app.jobs.subscribe_to(&id);
    let listener = JobEventStream {
        app,
        tenant: caller.tenant,
        key: caller.key,
        expires_ms: caller.expires_ms,
        signed_under: caller.signed_under,
        id,
        after,
        changes,
        waiting: VecDeque::new(),
    };
    let stream = futures::stream::unfold(listener, |mut listener| async move {
        let event = listener.next().await?;
        Some((Ok::<_, Infallible>(event), listener))
    });
    Ok((UNBUFFERED, Sse::new(stream).keep_alive(KeepAlive::new().interval(KEEP_ALIVE))))
}

/// An event in the form of the stream: its data with its time.
fn sse(event: EventRecord) -> Event {
    let mut data: serde_json::Value = serde_json::from_str(&event.data).unwrap_or_default();
    data["at"] = rfc3339(event.at_ms).into();
    Event::default().id(event.seq.to_string()).event(event.kind).data(data.to_string())
}

/// The event stream of one job. Events are read from the database; the channel only announces changes.
struct JobEventStream {
    app: AppState,
    tenant: TenantId,
    key: KeyId,
    /// Expiry time of the key or the signed URL.
    expires_ms: Option<i64>,
    /// Hash of the secret that signed the URL.
    signed_under: Option<[u8; 32]>,
    id: JobId,
    after: i64,
    changes: watch::Receiver<()>,
    waiting: VecDeque<EventRecord>,
}

impl JobEventStream {
    /// The next event; `None` at the end of the stream.
    async fn next(&mut self) -> Option<Event> {
        loop {
            if let Some(event) = self.waiting.pop_front() {
                self.after = event.seq;
                return Some(sse(event));
            }
            match self.fetch().await {
                Ok(true) => {}
                Ok(false) => return None,
                Err(error) => {
                    tracing::error!(%error, "cannot read events");
                    return None;
                }
            }
        }
    }

    /// Whether the key, and the signed URL if one is used, are still valid.
    async fn may_listen(&self) -> Result<bool, StoreError> {
        let is_over = self.expires_ms.is_some_and(|end| self.app.keys.now_ms() >= end);
        if is_over || self.app.keys.bearer_of(self.key.as_str()).await?.is_none() {
            return Ok(false);
        }
        let Some(under) = self.signed_under else { return Ok(true) };
        let secret = self.app.signing.read().await?;
        Ok(secret.is_some_and(|secret| digest(&secret) == under))
    }

    /// Fetches new events or waits for them; `false` if the stream ends or the listener is no longer permitted to read it.
    async fn fetch(&mut self) -> Result<bool, StoreError> {
        self.changes.mark_unchanged();
        if !self.may_listen().await? {
            return Ok(false);
        }
        // The state is read first: the last event of a terminal job is then already written.
        let job = self.app.store.job(&self.tenant, &self.id).await?;
        self.waiting = self.app.jobs.events_after(&self.tenant, &self.id, self.after).await?.into();
        if !self.waiting.is_empty() {
            return Ok(true);
        }
        if job.is_none_or(|job| job.state.is_terminal()) {
            return Ok(false);
        }
        tokio::select! {
            () = self.app.stop.cancelled() => Ok(false),
            _ = self.changes.changed() => Ok(true),
            () = tokio::time::sleep(POLL) => Ok(true),
        }
    }
}
