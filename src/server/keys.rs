//! `/v1/keys`: API keys of a tenant; for the operator, of all tenants.

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
use crate::server::problem::Problem;
use crate::store::{KeyRecord, NewKeyRecord};
use relume_api::keys::{CreatedKey, KeyView, NewKey, RevokedKey, Scope};
use relume_api::{KeyId, List, TenantId};

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<AppState> {
    OpenApiRouter::new()
        .routes(routes!(list_keys, create_key))
        .routes(routes!(get_key))
        .routes(routes!(revoke_key))
}

/// Create an API key
///
/// The answer contains the complete key, which the server shows once. The command `relume keys create`
/// creates the first key of a server.
///
/// Administrators of the tenant `default` create keys for any tenant. Other administrators create keys for
/// their own tenant, without the scope `priority`. Only keys of the tenant `default` can have the scopes
/// `metrics` and `work`. A key expires at the latest with the key that created it, and is revoked with it.
#[utoipa::path(
    post, path = "/v1/keys", tag = "keys", request_body = NewKey,
    responses(
        (status = 201, body = CreatedKey), (status = 403, body = Problem), (status = 422, body = Problem)
    )
)]
async fn create_key(
    State(app): State<AppState>,
    caller: Caller,
    JsonBody(key): JsonBody<NewKey>,
) -> Result<Response, Problem> {
    if let Some((field, why)) = key.validation_error(&caller.tenant) {
        return Err(Problem::invalid_field(format!("/{field}"), why));
    }
    if !caller.has_key {
        // The first key permanently locks out callers without a key.
        let detail = "create the first key of a server on its machine with `relume keys create`";
        return Err(Problem::new(
            StatusCode::FORBIDDEN,
            "forbidden",
            "The first key cannot be created over HTTP",
        )
        .detail(detail));
    }
    if key.tenant.as_ref().is_some_and(|tenant| *tenant != caller.tenant) {
        caller.require_operator(Scope::Admin)?;
    }
    if key.scopes.contains(&Scope::Priority) {
        // Priority affects jobs of all tenants.
        caller.require_operator(Scope::Admin)?;
    }
    let now_ms = app.jobs.now_ms();
    let expires_ms = key.expires_in.map(|s| now_ms.saturating_add_unsigned(s.saturating_mul(1000)));
    let made_by = caller.has_stored_key().then_some(caller.key);
    let record = NewKeyRecord {
        name: key.name,
        tenant: key.tenant.unwrap_or(caller.tenant),
        scopes: key.scopes,
        expires_ms: expires_ms.into_iter().chain(caller.expires_ms).min(),
        made_by,
    };
    let (record, secret) = app.store.create_key(&record, now_ms).await?;
    tracing::info!(made = %record.id, of = %record.tenant, "created a key");
    let headers = [
        (header::LOCATION, location(&record.id)?),
        (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
    ];
    Ok((StatusCode::CREATED, headers, Json(CreatedKey { key: view(record), secret })).into_response())
}

/// List API keys
///
/// Returns all keys, including revoked and expired keys, without their secrets, newest first. Administrators
/// of the tenant `default` see the keys of all tenants, others those of their own tenant.
#[utoipa::path(
    get, path = "/v1/keys", tag = "keys", params(PageQuery),
    responses((status = 200, body = List<KeyView>), (status = 403, body = Problem))
)]
async fn list_keys(
    State(app): State<AppState>,
    caller: Caller,
    QueryString(query): QueryString<PageQuery>,
) -> Result<Json<List<KeyView>>, Problem> {
    let page = query.page(async |id| app.store.key(visible(&caller), &id.into()).await).await?;
    let keys = app.store.keys(visible(&caller), &page.store_page()).await?;
    Ok(Json(page.list(keys, view)))
}

/// Get an API key
///
/// Returns the key without its secret.
#[utoipa::path(
    get, path = "/v1/keys/{id}", tag = "keys", params(("id" = String, Path, description = "Key identifier")),
    responses(
        (status = 200, body = KeyView), (status = 403, body = Problem), (status = 404, body = Problem)
    )
)]
async fn get_key(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<KeyId>,
) -> Result<Json<KeyView>, Problem> {
    let key = app.store.key(visible(&caller), &id).await?;
    key.map(|key| Json(view(key))).ok_or_else(|| Problem::not_found("key", id.as_str()))
}

/// Revoke an API key
///
/// Revokes the key and all keys that it created, directly or through other keys. The server refuses them from
/// the next request on. Revoked keys remain in lists. A repeated request has no effect.
#[utoipa::path(
    post, path = "/v1/keys/{id}/revoke", tag = "keys", params(("id" = String, Path, description = "Key identifier")),
    responses(
        (status = 200, body = RevokedKey), (status = 403, body = Problem), (status = 404, body = Problem)
    )
)]
async fn revoke_key(
    State(app): State<AppState>,
    caller: Caller,
    UrlPath(id): UrlPath<KeyId>,
) -> Result<Json<RevokedKey>, Problem> {
    let revoked = app.store.revoke_key(visible(&caller), &id, app.jobs.now_ms()).await?;
    let (key, took_along) = revoked.ok_or_else(|| Problem::not_found("key", id.as_str()))?;
    tracing::info!(revoked = %key.id, of = %key.tenant, took_along = took_along.len(), "revoked a key");
    Ok(Json(RevokedKey { key: view(key), took_along }))
}

/// The tenant whose keys a caller may see; `None` for all tenants.
fn visible(caller: &Caller) -> Option<&TenantId> {
    (!caller.tenant.is_operator()).then_some(&caller.tenant)
}

fn location(id: &KeyId) -> Result<HeaderValue, Problem> {
    HeaderValue::from_str(&format!("/v1/keys/{id}")).map_err(Problem::internal)
}

fn view(key: KeyRecord) -> KeyView {
    KeyView {
        id: key.id,
        name: key.name,
        tenant: key.tenant,
        scopes: key.scopes,
        made_by: key.made_by,
        created_at: rfc3339(key.created_ms),
        expires_at: key.expires_ms.map(rfc3339),
        last_used_at: key.last_used_ms.map(rfc3339),
        revoked_at: key.revoked_ms.map(rfc3339),
    }
}
