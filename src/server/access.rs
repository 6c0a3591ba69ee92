//! The access table with the requirement of each route, and its check.

use std::sync::Arc;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::server::caller::Caller;
use crate::server::keyring::Keyring;
use crate::server::problem::Problem;
use crate::server::rate_limiter::{RateLimitStatus, RateLimiter};
use crate::server::signing::{SignedQuery, SignedResource};
use crate::server::signing_secret::{SigningSecret, digest};
#[cfg(feature = "web")]
use crate::server::web;
use relume_api::ModelId;
use relume_api::keys::Scope::{self, Admin, Metrics, Read, Render, Submit, Work};

/// The requirement of a route.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Access {
    /// No requirement.
    Open,
    /// A key with this scope.
    Needs(Scope),
    /// A key with this scope or `admin`, of the tenant `default` of the operator.
    Operator(Scope),
}

use Access::{Needs, Open, Operator};

/// Header with the query of a share page, in the requests of that page.
const SHARE: &str = "relume-share";

/// All operations. The handler of a missing operation gets no caller and fails.
const TABLE: &[(Method, &str, Access)] = &[
    (Method::GET, "/healthz", Open),
    (Method::GET, "/readyz", Open),
    (Method::GET, "/v1/openapi.json", Open),
    (Method::GET, "/metrics", Operator(Metrics)),
    (Method::GET, "/v1/captures", Needs(Read)),
    (Method::POST, "/v1/captures", Needs(Submit)),
    (Method::POST, "/v1/captures/validate", Needs(Submit)),
    (Method::GET, "/v1/captures/{id}", Needs(Read)),
    (Method::GET, "/v1/captures/{id}/cameras", Needs(Read)),
    (Method::GET, "/v1/captures/{id}/log", Needs(Read)),
    (Method::GET, "/v1/captures/{id}/photographs", Needs(Read)),
    (Method::GET, "/v1/captures/{id}/photographs/{name}", Needs(Read)),
    (Method::PATCH, "/v1/captures/{id}", Needs(Submit)),
    (Method::DELETE, "/v1/captures/{id}", Needs(Submit)),
    (Method::GET, "/v1/environments", Needs(Read)),
    (Method::POST, "/v1/environments", Needs(Submit)),
    (Method::GET, "/v1/environments/{id}", Needs(Read)),
    (Method::PATCH, "/v1/environments/{id}", Needs(Submit)),
    (Method::DELETE, "/v1/environments/{id}", Needs(Submit)),
    (Method::GET, "/v1/exports", Needs(Read)),
    (Method::GET, "/v1/exports/{id}", Needs(Read)),
    (Method::DELETE, "/v1/exports/{id}", Needs(Render)),
    (Method::GET, "/v1/exports/{id}/file", Needs(Read)),
    (Method::GET, "/v1/jobs", Needs(Read)),
    (Method::POST, "/v1/jobs", Needs(Submit)),
    (Method::GET, "/v1/jobs/{id}", Needs(Read)),
    (Method::DELETE, "/v1/jobs/{id}", Needs(Submit)),
    (Method::PATCH, "/v1/jobs/{id}", Needs(Submit)),
    (Method::POST, "/v1/jobs/{id}/cancel", Needs(Submit)),
    (Method::POST, "/v1/jobs/{id}/retry", Needs(Submit)),
    (Method::GET, "/v1/jobs/{id}/events", Needs(Read)),
    (Method::GET, "/v1/jobs/{id}/preview", Needs(Read)),
    (Method::GET, "/v1/keys", Needs(Admin)),
    (Method::POST, "/v1/keys", Needs(Admin)),
    (Method::GET, "/v1/keys/{id}", Needs(Admin)),
    (Method::POST, "/v1/keys/{id}/revoke", Needs(Admin)),
    (Method::GET, "/v1/models", Needs(Read)),
    (Method::GET, "/v1/models/{id}", Needs(Read)),
    (Method::PATCH, "/v1/models/{id}", Needs(Submit)),
    (Method::DELETE, "/v1/models/{id}", Needs(Submit)),
    (Method::GET, "/v1/models/{id}/materials", Needs(Read)),
    (Method::GET, "/v1/models/{id}/materials/{material}/mask", Needs(Read)),
    (Method::POST, "/v1/models/{id}/next-photographs", Needs(Render)),
    (Method::PUT, "/v1/models/{id}/calibration", Needs(Submit)),
    (Method::DELETE, "/v1/models/{id}/calibration", Needs(Submit)),
    (Method::GET, "/v1/models/{id}/card", Needs(Read)),
    (Method::GET, "/v1/models/{id}/files/{name}", Needs(Read)),
    (Method::POST, "/v1/models/{id}/exports", Needs(Render)),
    (Method::POST, "/v1/models/{id}/render", Needs(Render)),
    (Method::GET, "/v1/models/{id}/thumbnail", Needs(Read)),
    (Method::GET, "/v1/models/{id}/stream", Needs(Read)),
    (Method::GET, "/v1/models/{id}/light", Needs(Read)),
    // The page shows a model only to callers whose link is valid.
    (Method::GET, "/share/{id}", Open),
    (Method::POST, "/v1/signed-urls", Needs(Read)),
    (Method::OPTIONS, "/v1/uploads", Open),
    (Method::GET, "/v1/uploads", Needs(Read)),
    (Method::POST, "/v1/uploads", Needs(Submit)),
    (Method::GET, "/v1/uploads/{id}", Needs(Submit)),
    (Method::HEAD, "/v1/uploads/{id}", Needs(Submit)),
    (Method::PATCH, "/v1/uploads/{id}", Needs(Submit)),
    (Method::POST, "/v1/uploads/{id}", Needs(Submit)),
    (Method::DELETE, "/v1/uploads/{id}", Needs(Submit)),
    (Method::GET, "/v1/usage", Needs(Read)),
    (Method::GET, "/v1/webhooks", Needs(Admin)),
    (Method::POST, "/v1/webhooks", Needs(Admin)),
    (Method::GET, "/v1/webhooks/{id}", Needs(Admin)),
    (Method::PATCH, "/v1/webhooks/{id}", Needs(Admin)),
    (Method::DELETE, "/v1/webhooks/{id}", Needs(Admin)),
    (Method::POST, "/v1/webhooks/{id}/rotate-secret", Needs(Admin)),
    (Method::GET, "/v1/webhooks/{id}/deliveries", Needs(Admin)),
    (Method::POST, "/v1/webhooks/{id}/deliveries/{delivery}/replay", Needs(Admin)),
    (Method::GET, "/v1/workers", Operator(Metrics)),
    (Method::GET, "/v1/workers/{id}", Operator(Metrics)),
    (Method::PATCH, "/v1/workers/{id}", Operator(Admin)),
    (Method::POST, "/v1/work/claims", Operator(Work)),
    (Method::POST, "/v1/work/{job}/heartbeat", Operator(Work)),
    (Method::POST, "/v1/work/{job}/progress", Operator(Work)),
    (Method::POST, "/v1/work/{job}/warnings", Operator(Work)),
    (Method::POST, "/v1/work/{job}/model", Operator(Work)),
    (Method::POST, "/v1/work/{job}/end", Operator(Work)),
    (Method::GET, "/v1/work/{job}/capture", Operator(Work)),
    (Method::GET, "/v1/work/{job}/environments/{environment}", Operator(Work)),
    (Method::GET, "/v1/work/{job}/checkpoint", Operator(Work)),
    (Method::PUT, "/v1/work/{job}/checkpoints/{step}", Operator(Work)),
    (Method::PUT, "/v1/work/{job}/files/{name}", Operator(Work)),
];

/// The entry of the table for a request with a matched route.
fn access_of(request: &Request) -> Option<Access> {
    let route = request.extensions().get::<MatchedPath>();
    // The web app, to which a browser is sent from an unknown path, asks for a key by itself.
    #[cfg(feature = "web")]
    if route.is_none() && web::redirect(request.method(), request.uri(), request.headers()).is_some() {
        return Some(Open);
    }
    let route = route?;
    #[cfg(feature = "web")]
    if web::ROUTES.contains(&route.as_str()) {
        return Some(Open);
    }
    // A handler of GET also answers HEAD.
    let method = if request.method() == Method::HEAD { &Method::GET } else { request.method() };
    TABLE.iter().find(|(m, path, _)| m == method && *path == route.as_str()).map(|line| line.2)
}

/// The components of access control.
pub(super) struct AccessControl {
    pub(super) keys: Arc<Keyring>,
    /// The secret for signing URLs.
    pub(super) signing: SigningSecret,
    /// The rate limits.
    pub(super) rate_limiter: RateLimiter,
}

/// Identifies the caller of a request and checks the access table.
pub(super) async fn check(
    State(access_control): State<Arc<AccessControl>>,
    request: Request,
    next: Next,
) -> Response {
    let access = access_of(&request);
    if access == Some(Open) {
        return next.run(request).await;
    }
    let mut rate_limit = None;
    let mut response = match access_control.admit(access, request, &mut rate_limit).await {
        Ok(request) => next.run(request).await,
        Err(problem) => problem.into_response(),
    };
    if let Some(rate_limit) = rate_limit {
        rate_limit.write_headers(response.headers_mut());
    }
    response
}

impl AccessControl {
    /// The request with its caller. From then on `rate_limit` has the rate limit status of the caller's key.
    async fn admit(
        &self,
        access: Option<Access>,
        mut request: Request,
        rate_limit: &mut Option<RateLimitStatus>,
    ) -> Result<Request, Problem> {
        let caller = if SignedQuery::is_present(request.uri().query()) {
            self.signer(&mut request).await?
        } else if let Some(share) = request.headers().get(SHARE).cloned() {
            let model = shared_model(&request).ok_or_else(invalid_signature)?;
            self.sharer(&model, share.to_str().unwrap_or_default()).await?
        } else {
            self.keys.caller(bearer(&request)).await?.ok_or_else(Problem::unauthorized)?
        };
        caller.record_in_span();
        *rate_limit = self.rate_limiter.take(&caller, self.keys.now_ms());
        rate_limit.as_ref().map_or(Ok(()), RateLimitStatus::check)?;
        match access {
            Some(Needs(scope)) => caller.require_scope(scope)?,
            Some(Operator(scope)) => caller.require_operator(scope)?,
            Some(Open) => {}
            // No route matches the path and method, so the request is refused without identifying the caller.
            None => return Ok(request),
        }
        request.extensions_mut().insert(caller);
        Ok(request)
    }

    /// The caller of a signed URL, with the scope to read only. Removes the signature parameters from the URL.
    async fn signer(&self, request: &mut Request) -> Result<Caller, Problem> {
        let uri = request.uri().clone();
        let signed = SignedQuery::parse(uri.query()).ok_or_else(invalid_signature)?;
        if !reads(request) || SignedResource::of(uri.path()).is_none() {
            return Err(invalid_signature());
        }
        let caller = signer(&self.keys, &self.signing, &signed, uri.path()).await?;
        let query = signed.query.map_or_else(String::new, |query| format!("?{query}"));
        *request.uri_mut() = format!("{}{query}", uri.path()).parse().map_err(Problem::internal)?;
        Ok(caller)
    }

    /// The caller that shared a model. `share` is the query of its page.
    async fn sharer(&self, model: &ModelId, share: &str) -> Result<Caller, Problem> {
        let signed = SignedQuery::parse(Some(share)).ok_or_else(invalid_signature)?;
        signer(&self.keys, &self.signing, &signed, &format!("/share/{model}")).await
    }
}

/// The model whose picture a request reads, which its share page may do.
fn shared_model(request: &Request) -> Option<ModelId> {
    match SignedResource::of(request.uri().path()) {
        Some(SignedResource::Picture(model)) if reads(request) => Some(model),
        _ => None,
    }
}

/// The caller that signed a URL with this path, with the scope to read only.
///
/// # Errors
/// 403 if the signature is not valid.
pub(super) async fn signer(
    keys: &Keyring,
    signing: &SigningSecret,
    signed: &SignedQuery<'_>,
    path: &str,
) -> Result<Caller, Problem> {
    let secret = signing.read().await.map_err(Problem::internal)?;
    let caller = keys.bearer_of(signed.key).await?;
    let (Some(secret), Some(caller)) = (secret, caller) else { return Err(invalid_signature()) };
    let is_over = keys.now_ms() / 1000 >= signed.expires;
    if is_over || !signed.is_valid_for(&caller, &secret, path) {
        return Err(invalid_signature());
    }
    caller.require_scope(Read)?;
    keys.record_signed_use(&caller);
    let until = signed.expires.saturating_mul(1000);
    let expires_ms = Some(caller.expires_ms.map_or(until, |key| key.min(until)));
    let signed_under = Some(digest(&secret));
    Ok(Caller { scopes: vec![Read], expires_ms, signed_under, ..caller })
}

fn reads(request: &Request) -> bool {
    matches!(*request.method(), Method::GET | Method::HEAD)
}

fn invalid_signature() -> Problem {
    Problem::new(StatusCode::FORBIDDEN, "bad-signature", "The signed URL is not valid").detail(
        "it has expired, was changed, was signed with another secret, or its key was revoked; get a new one from /v1/signed-urls",
    )
}

fn bearer(request: &Request) -> Option<&str> {
    let value = request.headers().get(header::AUTHORIZATION)?.to_str().ok()?;
    let (scheme, key) = value.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| key.trim())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::server::openapi;

    #[test]
    fn access_table_lists_exactly_the_openapi_operations() {
        let description = serde_json::to_value(openapi()).unwrap();
        let mut described = BTreeSet::new();
        for (path, item) in description["paths"].as_object().unwrap() {
            let operations = item.as_object().unwrap().iter().filter(|(_, o)| o.get("responses").is_some());
            described.extend(operations.map(|(method, _)| (method.to_uppercase(), path.clone())));
        }
        let listed: BTreeSet<_> = TABLE.iter().map(|(m, p, _)| (m.to_string(), (*p).to_owned())).collect();
        assert_eq!(listed, described);
        assert_eq!(listed.len(), TABLE.len(), "an entry occurs twice");
    }
}
