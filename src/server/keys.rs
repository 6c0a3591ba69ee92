//! `/v1/keys`: API keys of a tenant; of all tenants for those who run the server.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::api::keys::{CreatedKey, KeyView, NewKey, RevokedKey, Scope};
use crate::api::{KeyId, List, Problem, TenantId};
use crate::server::app::Shared;
use crate::server::caller::Caller;
use crate::server::extract::{JsonBody, QueryString, UrlPath};
use crate::server::listing::{PageQuery, rfc3339};
use crate::store::{KeyRecord, NewKeyRecord};

/// The routes of this file.
pub(super) fn routes() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(list_keys, create_key))
        .routes(routes!(get_key))
        .routes(routes!(revoke_key))
}

/// Make an API key
///
/// The answer has the key itself, which is shown this once. The first key of a server is made by `relume keys create`. Administrators of the tenant `default` make keys for any
/// tenant, others for their own, without the scope `priority`. Only keys of `default` have the scope `metrics`. A key that a key made expires with it at the latest, and is revoked with it.
#[utoipa::path(
    post, path = "/v1/keys", tag = "keys", request_body = NewKey,
    responses(
        (status = 201, body = CreatedKey), (status = 403, body = Problem), (status = 422, body = Problem)
    )
)]
async fn create_key(
    State(app): State<Shared>,
    caller: Caller,
    JsonBody(key): JsonBody<NewKey>,
) -> Result<Response, Problem> {
    if let Some((field, why)) = key.fault(&caller.tenant) {
        return Err(Problem::invalid_field(format!("/{field}"), why));
    }
    if !caller.has_key {
        // The first key locks out everybody else, for good.
        let detail =
            "the first key of a server is made by whoever may write its data directory: `relume keys create`";
        return Err(Problem::new(StatusCode::FORBIDDEN, "forbidden", "The first key is not made by HTTP")
            .detail(detail));
    }
    if key.tenant.as_ref().is_some_and(|tenant| *tenant != caller.tenant) {
        caller.needs_operator(Scope::Admin)?;
    }
    if key.scopes.contains(&Scope::Priority) {
        // Jobs of all tenants wait for one device.
        caller.needs_operator(Scope::Admin)?;
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
    tracing::info!(made = %record.id, of = %record.tenant, "made a key");
    let headers = [
        (header::LOCATION, location(&record.id)?),
        (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
    ];
    Ok((StatusCode::CREATED, headers, Json(CreatedKey { key: view(record), secret })).into_response())
}

/// List API keys
///
/// Without their secrets; revoked and expired ones too.
#[utoipa::path(
    get, path = "/v1/keys", tag = "keys", params(PageQuery),
    responses((status = 200, body = List<KeyView>), (status = 403, body = Problem))
)]
async fn list_keys(
    State(app): State<Shared>,
    caller: Caller,
    QueryString(query): QueryString<PageQuery>,
) -> Result<Json<List<KeyView>>, Problem> {
    let page = query.page(async |id| app.store.key(visible(&caller), &id.into()).await).await?;
    let keys = app.store.keys(visible(&caller), &page.of_store()).await?;
    Ok(Json(page.list(keys, view)))
}

/// Get an API key
#[utoipa::path(
    get, path = "/v1/keys/{id}", tag = "keys", params(("id" = String, Path)),
    responses(
        (status = 200, body = KeyView), (status = 403, body = Problem), (status = 404, body = Problem)
    )
)]
async fn get_key(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<KeyId>,
) -> Result<Json<KeyView>, Problem> {
    let key = app.store.key(visible(&caller), &id).await?;
    key.map(|key| Json(view(key))).ok_or_else(|| Problem::not_found("key", id.as_str()))
}

/// Revoke an API key
///
/// It is refused from the next request on, and stays in lists; so are the keys that it made, and those that these made. Asking again changes nothing.
#[utoipa::path(
    post, path = "/v1/keys/{id}/revoke", tag = "keys", params(("id" = String, Path)),
    responses(
        (status = 200, body = RevokedKey), (status = 403, body = Problem), (status = 404, body = Problem)
    )
)]
async fn revoke_key(
    State(app): State<Shared>,
    caller: Caller,
    UrlPath(id): UrlPath<KeyId>,
) -> Result<Json<RevokedKey>, Problem> {
    let revoked = app.store.revoke_key(visible(&caller), &id, app.jobs.now_ms()).await?;
    let (key, took_along) = revoked.ok_or_else(|| Problem::not_found("key", id.as_str()))?;
    tracing::info!(revoked = %key.id, of = %key.tenant, took_along = took_along.len(), "revoked a key");
    Ok(Json(RevokedKey { key: view(key), took_along }))
}

/// The tenant whose keys a caller may see; `None` when they may see all.
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
