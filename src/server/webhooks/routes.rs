//! `/v1/webhooks`: webhooks of a tenant, managed by its administrators, and their deliveries.

use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::extract::{JsonBody, QueryString, UrlPath};
use crate::server::listing::{PageQuery, rfc3339};
use crate::server::outbound::OutboundTarget;
use crate::server::problem::Problem;
use crate::server::webhooks::policy::WebhookPolicy;
use crate::server::webhooks::signature::{encode_secret, fresh_secret};
use crate::store::{DeliveryRecord, Replay, WebhookRecord};
use relume_api::webhooks::{
    AttemptView, CreatedWebhook, DeliveryState, DeliveryView, NewWebhook, WebhookChange, WebhookView,
    validate_webhook,
};
use relume_api::{DeliveryId, List, WebhookId};

/// Timeout of the DNS lookup for a new webhook.
const DNS_TIMEOUT: Duration = Duration::from_secs(5);

/// Time for which a replaced secret also signs, milliseconds.
const FORMER_SECRET_VALID_MS: i64 = 24 * 3600 * 1000;

/// The routes of this file.
pub(in crate::server) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(create_webhook, list_webhooks))
        .routes(routes!(get_webhook, change_webhook, delete_webhook))
        .routes(routes!(rotate_webhook_secret))
        .routes(routes!(list_deliveries))
        .routes(routes!(replay_delivery))
}

/// Create a webhook
///
/// The server sends a `POST` to the URL for each selected event of the tenant's jobs. It signs messages
/// according to [Standard Webhooks](https://www.standardwebhooks.com) with the headers `webhook-id`,
/// `webhook-timestamp` and `webhook-signature`. The body is
/// `{"type": "job.succeeded", "timestamp": "...", "data": {"job": {...}}}`.
///
/// The answer contains the secret, which the server shows once. A tenant can have at most 16 webhooks. A
/// webhook remains when the key that created it expires or is revoked.
#[utoipa::path(
    post, path = "/v1/webhooks", tag = "webhooks", request_body = NewWebhook,
    responses(
        (status = 201, body = CreatedWebhook),
        (status = 409, body = Problem, description = "The tenant has the maximum number of webhooks"),
        (status = 422, body = Problem, description = "A field is invalid, or the host has no public address")
    )
)]
async fn create_webhook(
    State(app): State<AppState>,
    caller: Caller,
    JsonBody(webhook): JsonBody<NewWebhook>,
) -> Result<Response, Problem> {
    check(
        Some(&webhook.url),
        validate_webhook(Some(&webhook.events), webhook.name.as_deref()),
        &app.webhooks,
    )
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
    let created = CreatedWebhook { secret: encode_secret(&made.secret), webhook: view(made) };
    Ok((StatusCode::CREATED, headers, Json(created)).into_response())
}

/// List webhooks
///
/// Returns the webhooks of the caller's tenant without their secrets, newest first.
#[utoipa::path(
    get, path = "/v1/webhooks", tag = "webhooks", params(PageQuery),
    responses((status = 200, body = List<WebhookView>))
)]
async fn list_webhooks(
    State(app): State<AppState>,
    caller: Caller,
    QueryString(query): QueryString<PageQuery>,
) -> Result<Json<List<WebhookView>>, Problem> {
    let page = query.page(async |id| app.store.webhook(&caller.tenant, &id.into()).await).await?;
    let found = app.store.webhooks(&caller.tenant, &page.store_page()).await?;
    Ok(Json(page.list(found, view)))
}

/// Get a webhook
///
/// Returns the webhook without its secret.
#[utoipa::path(
    get, path = "/v1/webhooks/{id}", tag = "webhooks",
    params(("id" = String, Path, description = "Webhook identifier")),
    responses((status = 200, body = WebhookView), (status = 404, body = Problem))
)]
async fn get_webhook(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<WebhookId>,
) -> Result<Json<WebhookView>, Problem> {
    found(app.store.webhook(&caller.tenant, &id).await?, &id).map(|webhook| Json(view(webhook)))
}

/// Change a webhook
///
/// Omitted fields are unchanged. `{"enabled": true}` also enables a webhook that the server disabled, and
/// sends its queued messages.
#[utoipa::path(
    patch, path = "/v1/webhooks/{id}", tag = "webhooks",
    params(("id" = String, Path, description = "Webhook identifier")),
    request_body = WebhookChange,
    responses((status = 200, body = WebhookView), (status = 404, body = Problem), (status = 422, body = Problem))
)]
async fn change_webhook(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<WebhookId>,
    JsonBody(change): JsonBody<WebhookChange>,
) -> Result<Json<WebhookView>, Problem> {
    found(app.store.webhook(&caller.tenant, &id).await?, &id)?;
    let fault = validate_webhook(change.events.as_deref(), change.name.as_deref());
    check(change.url.as_deref(), fault, &app.webhooks).await?;
    let changed = app.store.change_webhook(&caller.tenant, &id, &change).await?;
    found(changed, &id).map(|webhook| Json(view(webhook)))
}

/// Rotate the secret of a webhook
///
/// The answer contains the new secret, which the server shows once. For 24 hours the server signs messages
/// with both the new and the previous secret, so that the receiver can change to the new secret without
/// missing messages. Older secrets become invalid at once.
#[utoipa::path(
    post, path = "/v1/webhooks/{id}/rotate-secret", tag = "webhooks",
    params(("id" = String, Path, description = "Webhook identifier")),
    responses((status = 200, body = CreatedWebhook), (status = 404, body = Problem))
)]
async fn rotate_webhook_secret(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<WebhookId>,
) -> Result<Response, Problem> {
    let secret = fresh_secret().map_err(Problem::internal)?;
    let former_until_ms = app.jobs.now_ms().saturating_add(FORMER_SECRET_VALID_MS);
    let rotated = app.store.rotate_webhook_secret(&caller.tenant, &id, &secret, former_until_ms).await?;
    let rotated = found(rotated, &id)?;
    let shown = CreatedWebhook { secret: encode_secret(&rotated.secret), webhook: view(rotated) };
    Ok(([(header::CACHE_CONTROL, HeaderValue::from_static("no-store"))], Json(shown)).into_response())
}

/// Delete a webhook
///
/// Deletes the webhook with its queued and sent deliveries.
#[utoipa::path(
    delete, path = "/v1/webhooks/{id}", tag = "webhooks",
    params(("id" = String, Path, description = "Webhook identifier")),
    responses((status = 204, description = "Deleted"), (status = 404, body = Problem))
)]
async fn delete_webhook(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<WebhookId>,
) -> Result<StatusCode, Problem> {
    let deleted = app.store.delete_webhook(&caller.tenant, &id).await?;
    found(deleted.then_some(StatusCode::NO_CONTENT), &id)
}

/// List the deliveries of a webhook
///
/// Returns sent and queued deliveries with their attempts, newest first. The server keeps deliveries for 30
/// days.
#[utoipa::path(
    get, path = "/v1/webhooks/{id}/deliveries", tag = "webhooks",
    params(("id" = String, Path, description = "Webhook identifier"), PageQuery),
    responses((status = 200, body = List<DeliveryView>), (status = 404, body = Problem))
)]
async fn list_deliveries(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<WebhookId>,
    QueryString(query): QueryString<PageQuery>,
) -> Result<Json<List<DeliveryView>>, Problem> {
    found(app.store.webhook(&caller.tenant, &id).await?, &id)?;
    let page =
        query.page(async |before| app.store.delivery(&caller.tenant, &id, &before.into()).await).await?;
    let deliveries = app.store.deliveries(&caller.tenant, &id, &page.store_page()).await?;
    Ok(Json(page.list(deliveries, delivery_view)))
}

/// Replay a delivery
///
/// Sends the message again at once, with the same `webhook-id` and the same body, whether or not it was
/// delivered before.
#[utoipa::path(
    post, path = "/v1/webhooks/{id}/deliveries/{delivery}/replay", tag = "webhooks",
    params(
        ("id" = String, Path, description = "Webhook identifier"),
        ("delivery" = String, Path, description = "Delivery identifier")
    ),
    responses(
        (status = 202, body = DeliveryView), (status = 404, body = Problem),
        (status = 409, body = Problem, description = "The webhook is disabled")
    )
)]
async fn replay_delivery(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath((id, delivery)): UrlPath<(WebhookId, DeliveryId)>,
) -> Result<(StatusCode, Json<DeliveryView>), Problem> {
    match app.store.replay_delivery(&caller.tenant, &id, &delivery, app.jobs.now_ms()).await? {
        Replay::Accepted(delivery) => Ok((StatusCode::ACCEPTED, Json(delivery_view(delivery)))),
        Replay::SwitchedOff => Err(Problem::conflict(
            "webhook-off",
            "the webhook is disabled; enable it with PATCH {\"enabled\": true}",
        )),
        Replay::NotFound => Err(Problem::not_found("delivery", &format!("{id}/deliveries/{delivery}"))),
    }
}

/// # Errors
/// 422, which names the invalid field or the URL.
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
    let target = OutboundTarget::parse(url, policy.allow_http).map_err(wrong)?;
    let looked_up = tokio::time::timeout(DNS_TIMEOUT, target.addresses(policy.allow_private)).await;
    looked_up
        .unwrap_or_else(|_| Err("the address of its host was not found in time".to_owned()))
        .map_err(wrong)?;
    Ok(())
}

/// # Errors
/// 404 if the webhook does not exist.
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
