//! Who makes a request: the tenant whose things it may touch, and what it may do with them.

use axum::extract::FromRequestParts;
use axum::http::StatusCode;
use axum::http::request::Parts;

use crate::server::problem::Problem;
use crate::store::StoreError;
use relume_api::keys::Scope;
use relume_api::{KeyId, TenantId};

/// What stands for a key where there is none.
pub(super) const NO_KEY: &str = "none";

/// Keys that the server was started with are named so, with their number.
pub(super) const CONFIGURED: &str = "configured-";

/// Whoever makes a request. Handlers take it as an argument; there is one only where the table of `access` lets the
/// request through.
#[derive(Debug, Clone)]
pub(super) struct Caller {
    /// Whose things it may touch.
    pub(super) tenant: TenantId,
    /// What it may do.
    pub(super) scopes: Vec<Scope>,
    /// The key that it came with.
    pub(super) key: KeyId,
    /// Hash of that key; empty where there is none.
    pub(super) key_hash: String,
    /// When that key, or the URL that it signed, expires.
    pub(super) expires_ms: Option<i64>,
    /// False on a server without keys.
    pub(super) has_key: bool,
    /// Hash of the secret under which its URL was signed, if it came by one.
    pub(super) signed_under: Option<[u8; 32]>,
}

impl Caller {
    /// Everybody on a server without keys.
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

    /// Adds the key's identifier and the tenant to every line of the log about this request.
    pub(super) fn record_in_span(&self) {
        let span = tracing::Span::current();
        span.record("key", self.key.as_str());
        span.record("tenant", self.tenant.as_str());
    }

    /// # Errors
    /// 403 that names the scope that is missing.
    pub(super) fn require_scope(&self, scope: Scope) -> Result<(), Problem> {
        if self.scopes.contains(&scope) {
            return Ok(());
        }
        Err(Self::missing_permission(format!(
            "this operation requires a key with the scope {scope:?}",
            scope = scope.name()
        )))
    }

    /// Whether this is an administrator of the tenant of whoever runs the server.
    pub(super) fn is_operator(&self) -> bool {
        self.tenant.is_operator() && self.scopes.contains(&Scope::Admin)
    }

    /// What the store's refusal is to this caller: only whoever runs the server is told how much all tenants store.
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
    /// 403 unless this has the scope, or `admin`, of the tenant of whoever runs the server.
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
