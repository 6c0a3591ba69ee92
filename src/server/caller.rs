//! The caller of a request: its tenant and its scopes.

use axum::extract::FromRequestParts;
use axum::http::StatusCode;
use axum::http::request::Parts;

use crate::server::problem::Problem;
use crate::store::StoreError;
use relume_api::keys::Scope;
use relume_api::{KeyId, TenantId};

/// The key identifier of a caller without a key.
pub(super) const NO_KEY: &str = "none";

/// Prefix of the identifiers of keys from the configuration; their number follows.
pub(super) const CONFIGURED: &str = "configured-";

/// The caller of a request. Handlers take it as an argument; it exists only if the table in `access` permits the request.
#[derive(Debug, Clone)]
pub(super) struct Caller {
    /// The tenant whose resources it may use.
    pub(super) tenant: TenantId,
    /// Its scopes.
    pub(super) scopes: Vec<Scope>,
    /// The identifier of its key.
    pub(super) key: KeyId,
    /// Hash of its key; empty without a key.
    pub(super) key_hash: String,
    /// Expiry time of its key or signed URL.
    pub(super) expires_ms: Option<i64>,
    /// False on a server without keys.
    pub(super) has_key: bool,
    /// Hash of the secret that signed its URL, if it uses a signed URL.
    pub(super) signed_under: Option<[u8; 32]>,
}

impl Caller {
    /// The caller on a server without keys, with all scopes.
    pub(super) fn without_key() -> Self {
        Self {
            tenant: TenantId::of_operator(),
            scopes: Scope::ALL.to_vec(),
            key: KeyId::from(NO_KEY),
            key_hash: String::new(),
            expires_ms: None,
            has_key: false,
            signed_under: None,
        }
    }

    /// Whether its key is in the database.
    pub(super) fn has_stored_key(&self) -> bool {
        self.has_key && !self.key.as_str().starts_with(CONFIGURED)
    }

    /// Adds the key's identifier and the tenant to the log lines of this request.
    pub(super) fn record_in_span(&self) {
        let span = tracing::Span::current();
        span.record("key", self.key.as_str());
        span.record("tenant", self.tenant.as_str());
    }

    /// # Errors
    /// 403, which names the missing scope.
    pub(super) fn require_scope(&self, scope: Scope) -> Result<(), Problem> {
        if self.scopes.contains(&scope) {
            return Ok(());
        }
        Err(Self::missing_permission(format!(
            "this operation requires a key with the scope {scope:?}",
            scope = scope.name()
        )))
    }

    /// Whether the caller is an administrator of the operator's tenant.
    pub(super) fn is_operator(&self) -> bool {
        self.tenant.is_operator() && self.scopes.contains(&Scope::Admin)
    }

    /// The problem for an error of the store. Only the operator learns the stored bytes of all tenants.
    pub(super) fn problem_for(&self, error: StoreError) -> Problem {
        let numbers = matches!(error, StoreError::StorageLimitExceeded { .. }) && self.is_operator();
        let detail = numbers.then(|| error.to_string());
        let problem = Problem::from(error);
        match detail {
            Some(detail) => problem.detail(detail),
            None => problem,
        }
    }

    /// # Errors
    /// 403 unless the caller has the scope or `admin` in the operator's tenant.
    pub(super) fn require_operator(&self, scope: Scope) -> Result<(), Problem> {
        let permits = self.scopes.iter().any(|own| [scope, Scope::Admin].contains(own));
        if permits && self.tenant.is_operator() {
            return Ok(());
        }
        let tenant = TenantId::of_operator();
        let scope = scope.name();
        Err(Self::missing_permission(format!(
            "this operation requires a key with the scope {scope:?} of the tenant \"{tenant}\""
        )))
    }

    fn missing_permission(what: String) -> Problem {
        Problem::new(StatusCode::FORBIDDEN, "forbidden", "The key does not permit this operation")
            .detail(what)
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Caller {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        let caller = parts.extensions.get::<Self>().cloned();
        caller.ok_or_else(|| Problem::internal("a route without an entry in the access table"))
    }
}
