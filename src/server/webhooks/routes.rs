//! `/v1/webhooks`: made, looked at, changed and deleted by administrators of a tenant; and what was sent to them.

use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::webhooks::{
    AttemptView, CreatedWebhook, DeliveryState, DeliveryView, NewWebhook, WebhookChange, WebhookView,
    fault_of,
};
use crate::api::{DeliveryId, List, Problem, WebhookId};
use crate::server::app::Shared;
use crate::server::caller::Caller;
use crate::server::extract::{JsonBody, QueryString, UrlPath};
use crate::server::listing::{PageQuery, rfc3339};
use crate::server::outbound::Target;
use crate::server::webhooks::policy::WebhookPolicy;
use crate::server::webhooks::signature::{fresh_secret, written};
use crate::store::{DeliveryRecord, Replay, WebhookRecord};

/// How long the address of a new webhook may take to be found.
const LOOK_UP: Duration = Duration::from_secs(5);

/// How long a secret signs after it was replaced.
const FORMER_SIGNS_MS: i64 = 24 * 3600 * 1000;

/// The routes of this file.
pub(in crate::server) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(create_webhook, list_webhooks))
        .routes(routes!(get_webhook, change_webhook, delete_webhook))
        .routes(routes!(rotate_webhook_secret))
        .routes(routes!(list_deliveries))
        .routes(routes!(replay_delivery))
}

/// Make a webhook
///
/// From then on it is sent a `POST` whenever a job of the tenant ends in one of the ways that it names, signed as
/// [Standard Webhooks](https://www.standardwebhooks.com) has it: `webhook-id`, `webhook-timestamp`, `webhook-signature`. The body is
/// `{"type": "job.succeeded", "timestamp": "...", "data": {"job": {...}}}`. The answer has the secret, which is shown this once.
/// A tenant has at most 16. It stays when the key that made it ends.
#[utoipa::path(
    post, path = "/v1/webhooks", tag = "webhooks", request_body = NewWebhook,
    responses(
        (status = 201, body = CreatedWebhook),
        (status = 409, body = Problem, description = "The tenant has as many as it may"),
        (status = 422, body = Problem, description = "A field is wrong, or the host has no address that is public")
    )
)]
async fn create_webhook(
    State(app): State<Shared>,
    caller: Caller,
    JsonBody(webhook): JsonBody<NewWebhook>,
) -> Result<Response, Problem> {
    check(Some(&webhook.url), fault_of(Some(&webhook.events), webhook.name.as_deref()), &app.webhooks)
        .await?;
    let secret = fresh_secret().map_err(Problem::internal)?;
    let record = WebhookRecord {
        id: app.jobs.fresh_id(),
        made_by: caller.has_stored_key().then_some(caller.key),
        tenant: caller.tenant,
        url: webhook.url,
        events: webhook.events,
        name: webhook.name,
        secret,
        former_secret: None,
        former_until_ms: None,
        created_ms: app.jobs.now_ms(),
        enabled: true,
        failing_since_ms: None,
        switched_off_ms: None,
        switched_off_because: None,
    };
    let made = app.store.create_webhook(&record).await?;
    let location = format!("/v1/webhooks/{}", made.id);
    let headers = [
        (header::LOCATION, HeaderValue::from_str(&location).map_err(Problem::internal)?),
        (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
    ];
    let created = CreatedWebhook { secret: written(&made.secret), webhook: view(made) };
    Ok((StatusCode::CREATED, headers, Json(created)).into_response())
}

/// List webhooks
///
/// Without their secrets.
#[utoipa::path(
    get, path = "/v1/webhooks", tag = "webhooks", params(PageQuery),
    responses((status = 200, body = List<WebhookView>))
)]
async fn list_webhooks(
    State(app): State<Shared>,
    caller: Caller,
    QueryString(query): QueryString<PageQuery>,
) -> Result<Json<List<WebhookView>>, Problem> {
    let page = query.page(async |id| app.store.webhook(&caller.tenant, &id.into()).await).await?;
    let found = app.store.webhooks(&caller.tenant, &page.of_store()).await?;
    Ok(Json(page.list(found, view)))
}

/// Get a webhook
#[utoipa::path(
    get, path = "/v1/webhooks/{id}", tag = "webhooks", params(("id" = String, Path)),
    responses((status = 200, body = WebhookView), (status = 404, body = Problem))
)]
async fn get_webhook(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<WebhookId>,
) -> Result<Json<WebhookView>, Problem> {
    found(app.store.webhook(&caller.tenant, &id).await?, &id).map(|webhook| Json(view(webhook)))
}

/// Change a webhook
///
/// `{"enabled": true}` switches one on again that the server had switched off; what waited for it is sent then.
#[utoipa::path(
    patch, path = "/v1/webhooks/{id}", tag = "webhooks", params(("id" = String, Path)), request_body = WebhookChange,
    responses((status = 200, body = WebhookView), (status = 404, body = Problem), (status = 422, body = Problem))
)]
async fn change_webhook(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<WebhookId>,
    JsonBody(change): JsonBody<WebhookChange>,
) -> Result<Json<WebhookView>, Problem> {
    found(app.store.webhook(&caller.tenant, &id).await?, &id)?;
    let fault = fault_of(change.events.as_deref(), change.name.as_deref());
    check(change.url.as_deref(), fault, &app.webhooks).await?;
    let changed = app.store.change_webhook(&caller.tenant, &id, &change).await?;
    found(changed, &id).map(|webhook| Json(view(webhook)))
}

/// Give a webhook a new secret
///
/// The answer has it; it is shown this once. For 24 hours messages have two signatures, by the new secret and by the one before, so
/// that the receiver can take the new one over without missing a message. A secret that was replaced before ends at once.
#[utoipa::path(
    post, path = "/v1/webhooks/{id}/rotate-secret", tag = "webhooks", params(("id" = String, Path)),
    responses((status = 200, body = CreatedWebhook), (status = 404, body = Problem))
)]
async fn rotate_webhook_secret(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<WebhookId>,
) -> Result<Response, Problem> {
    let secret = fresh_secret().map_err(Problem::internal)?;
    let former_until_ms = app.jobs.now_ms().saturating_add(FORMER_SIGNS_MS);
    let rotated = app.store.rotate_webhook_secret(&caller.tenant, &id, &secret, former_until_ms).await?;
    let rotated = found(rotated, &id)?;
    let shown = CreatedWebhook { secret: written(&rotated.secret), webhook: view(rotated) };
    Ok(([(header::CACHE_CONTROL, HeaderValue::from_static("no-store"))], Json(shown)).into_response())
}

/// Delete a webhook
///
/// With what waits for it and what was sent to it.
#[utoipa::path(
    delete, path = "/v1/webhooks/{id}", tag = "webhooks", params(("id" = String, Path)),
    responses((status = 204, description = "Deleted"), (status = 404, body = Problem))
)]
async fn delete_webhook(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<WebhookId>,
) -> Result<StatusCode, Problem> {
    let deleted = app.store.delete_webhook(&caller.tenant, &id).await?;
    found(deleted.then_some(StatusCode::NO_CONTENT), &id)
}

/// List what was sent to a webhook
///
/// And what waits to be sent, newest first, with each attempt. Kept for 30 days.
#[utoipa::path(
    get, path = "/v1/webhooks/{id}/deliveries", tag = "webhooks", params(("id" = String, Path), PageQuery),
    responses((status = 200, body = List<DeliveryView>), (status = 404, body = Problem))
)]
async fn list_deliveries(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<WebhookId>,
    QueryString(query): QueryString<PageQuery>,
) -> Result<Json<List<DeliveryView>>, Problem> {
    found(app.store.webhook(&caller.tenant, &id).await?, &id)?;
    let page =
        query.page(async |before| app.store.delivery(&caller.tenant, &id, &before.into()).await).await?;
    let deliveries = app.store.deliveries(&caller.tenant, &id, &page.of_store()).await?;
    Ok(Json(page.list(deliveries, delivery_view)))
}

/// Send a message again
///
/// At once, with the same `webhook-id` and the same body, whether it was delivered before or not.
#[utoipa::path(
    post, path = "/v1/webhooks/{id}/deliveries/{delivery}/replay", tag = "webhooks",
    params(("id" = String, Path), ("delivery" = String, Path)),
    responses(
        (status = 202, body = DeliveryView), (status = 404, body = Problem),
        (status = 409, body = Problem, description = "The webhook is switched off")
    )
)]
async fn replay_delivery(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath((id, delivery)): UrlPath<(WebhookId, DeliveryId)>,
) -> Result<(StatusCode, Json<DeliveryView>), Problem> {
    match app.store.replay_delivery(&caller.tenant, &id, &delivery, app.jobs.now_ms()).await? {
        Replay::Accepted(delivery) => Ok((StatusCode::ACCEPTED, Json(delivery_view(delivery)))),
        Replay::SwitchedOff => Err(Problem::conflict(
            "webhook-off",
            "the webhook is switched off: PATCH it with {\"enabled\": true}",
        )),
        Replay::NotFound => Err(Problem::not_found("delivery", &format!("{id}/deliveries/{delivery}"))),
    }
}

/// # Errors
/// 422 for what is wrong: the fault that was found, or the URL.
async fn check(
    url: Option<&str>,
    fault: Option<(&'static str, &'static str)>,
    policy: &WebhookPolicy,
) -> Result<(), Problem> {
    if let Some((field, why)) = fault {
        return Err(Problem::invalid_field(format!("/{field}"), why));
    }
    let Some(url) = url else { return Ok(()) };
    let wrong = |why: String| Problem::invalid_field("/url", why);
    let target = Target::parse(url, policy.allow_http).map_err(wrong)?;
    let looked_up = tokio::time::timeout(LOOK_UP, target.addresses(policy.allow_private)).await;
    looked_up.unwrap_or_else(|_| Err("its host was not found in time".to_owned())).map_err(wrong)?;
    Ok(())
}

/// # Errors
/// 404 when there is none.
fn found<T>(found: Option<T>, id: &WebhookId) -> Result<T, Problem> {
    found.ok_or_else(|| Problem::not_found("webhook", id.as_str()))
}

fn view(webhook: WebhookRecord) -> WebhookView {
    WebhookView {
        id: webhook.id,
        url: webhook.url,
        events: webhook.events,
        name: webhook.name,
        enabled: webhook.enabled,
        made_by: webhook.made_by,
        created_at: rfc3339(webhook.created_ms),
        failing_since: webhook.failing_since_ms.map(rfc3339),
        switched_off_at: webhook.switched_off_ms.map(rfc3339),
        switched_off_because: webhook.switched_off_because,
    }
}

fn delivery_view(delivery: DeliveryRecord) -> DeliveryView {
    let attempts = delivery.attempts.into_iter();
    DeliveryView {
        id: delivery.id,
        event: delivery.event,
        job: delivery.job_id,
        state: delivery.state,
        created_at: rfc3339(delivery.created_ms),
        next_attempt_at: (delivery.state == DeliveryState::Pending).then(|| rfc3339(delivery.due_ms)),
        attempts: attempts
            .map(|a| AttemptView { at: rfc3339(a.at_ms), status: a.status, error: a.error })
            .collect(),
    }
}
