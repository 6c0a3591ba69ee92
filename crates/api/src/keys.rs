//! API keys: tenant, scopes and life.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::metadata::{NO_CONTROL, has_control};
use crate::{KeyId, TenantId};

/// Permission of an API key.
///
/// No scope includes another, with one exception: `admin` of the tenant `default` includes `metrics` and
/// `work`.
///
/// `read`: read captures, environment maps, jobs, models, exports, their files, thumbnails and usage.
/// `render`: render frames; create and delete exports. `submit`: upload; submit, change and cancel jobs;
/// delete resources. `admin`: manage API keys and webhooks. `priority`: submit jobs with a priority above 0;
/// only administrators of the tenant `default` grant it. `metrics`: read `/metrics` and `/v1/workers`; only
/// for the tenant `default`. `work`: claim jobs of all tenants and publish their models, as `relume worker`
/// does; only for the tenant `default`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Scope {
    /// Read captures, environment maps, jobs, models, exports, their files, thumbnails and usage.
    Read,
    /// Render frames; create and delete exports.
    Render,
    /// Upload; submit, change and cancel jobs; delete resources.
    Submit,
    /// Manage API keys and webhooks.
    Admin,
    /// Submit jobs with a priority above 0. Only administrators of the tenant `default` grant it.
    Priority,
    /// Read `/metrics` and `/v1/workers`. Only for the tenant `default`.
    Metrics,
    /// Claim jobs of all tenants and publish their models, as `relume worker` does. Only for the tenant
    /// `default`.
    Work,
}

impl Scope {
    /// All scopes.
    pub const ALL: [Self; 7] =
        [Self::Read, Self::Render, Self::Submit, Self::Admin, Self::Priority, Self::Metrics, Self::Work];

    /// True if keys of the tenant can have the scope.
    pub fn is_of(self, tenant: &TenantId) -> bool {
        !matches!(self, Self::Metrics | Self::Work) || tenant.is_operator()
    }

    /// Name in JSON and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Render => "render",
            Self::Submit => "submit",
            Self::Admin => "admin",
            Self::Priority => "priority",
            Self::Metrics => "metrics",
            Self::Work => "work",
        }
    }
}

impl fmt::Display for Scope {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Scope {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|scope| scope.name() == text);
        found.ok_or_else(|| {
            format!("{text:?} is not a scope; the scopes are {}", Self::ALL.map(Self::name).join(", "))
        })
    }
}

impl TenantId {
    /// The operator's tenant, `default`. Configured keys belong to it, and so does every caller of a server
    /// without keys. Its administrators manage the keys of all tenants.
    pub fn of_operator() -> Self {
        Self::from("default")
    }

    /// True for [`TenantId::of_operator`].
    pub fn is_operator(&self) -> bool {
        self.as_str() == "default"
    }

    /// The reason why the name is invalid, if it is.
    pub fn validation_error(&self) -> Option<&'static str> {
        let name = self.as_str();
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || matches!(c, '-' | '.');
        let good = (1..=64).contains(&name.len()) && name.chars().all(plain);
        (!good).then_some("must have 1 to 64 characters of a-z, 0-9, - and .")
    }
}

/// An API key to create.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewKey {
    /// Display name, 1 to 128 characters without control characters.
    #[schema(min_length = 1, max_length = 128)]
    pub name: String,
    /// Tenant of the key. Only administrators of the tenant `default` may name another tenant than their own.
    /// Omitted: the caller's tenant.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>, min_length = 1, max_length = 64, pattern = "^[a-z0-9.-]+$")]
    pub tenant: Option<TenantId>,
    /// Scopes, each at most once. `metrics` and `work` are allowed only for the tenant `default`.
    #[schema(min_items = 1, max_items = 7)]
    pub scopes: Vec<Scope>,
    /// Life of the key, seconds, 1 to 315,360,000 (ten years). The key expires with the caller's own key at
    /// the latest. Omitted: no expiry of its own.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 1, maximum = 315_360_000)]
    pub expires_in: Option<u64>,
}

impl NewKey {
    /// Longest life of an expiring key, seconds.
    pub const MAX_LIFETIME_S: u64 = 10 * 365 * 24 * 3600;

    /// The first invalid field and the reason. `caller` is the default tenant.
    pub fn validation_error(&self, caller: &TenantId) -> Option<(&'static str, String)> {
        if !(1..=128).contains(&self.name.chars().count()) {
            return Some(("name", "must have 1 to 128 characters".to_owned()));
        }
        if has_control(&self.name) {
            return Some(("name", NO_CONTROL.to_owned()));
        }
        if let Some(fault) = self.tenant.as_ref().and_then(TenantId::validation_error) {
            return Some(("tenant", fault.to_owned()));
        }
        let twice = (1..self.scopes.len()).any(|i| self.scopes[..i].contains(&self.scopes[i]));
        if self.scopes.is_empty() || twice {
            return Some(("scopes", "must contain at least one scope, each at most once".to_owned()));
        }
        let tenant = self.tenant.as_ref().unwrap_or(caller);
        if let Some(scope) = self.scopes.iter().find(|scope| !scope.is_of(tenant)) {
            let operator = TenantId::of_operator();
            return Some(("scopes", format!("{scope} is allowed only for the tenant {operator}")));
        }
        if self.expires_in.is_some_and(|s| !(1..=Self::MAX_LIFETIME_S).contains(&s)) {
            return Some(("expires_in", format!("must be 1 to {} seconds", Self::MAX_LIFETIME_S)));
        }
        None
    }
}

/// An API key without its secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct KeyView {
    /// Identifier. It is the second part of the key itself.
    #[schema(value_type = String)]
    pub id: KeyId,
    /// Display name.
    pub name: String,
    /// Tenant.
    #[schema(value_type = String)]
    pub tenant: TenantId,
    /// Scopes.
    pub scopes: Vec<Scope>,
    /// Identifier of the key that created this key; revoking that key also revokes this one. Absent for keys
    /// created by the command line or by a configured key.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>)]
    pub made_by: Option<KeyId>,
    /// Creation time, RFC 3339.
    pub created_at: String,
    /// Expiry time, RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub expires_at: Option<String>,
    /// Time of the last use, RFC 3339, to the minute.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub last_used_at: Option<String>,
    /// Time of the revocation, RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub revoked_at: Option<String>,
}

/// A new API key with its secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CreatedKey {
    /// The key without its secret.
    #[serde(flatten)]
    pub key: KeyView,
    /// The complete key to send as bearer token, `rlm_ID_SECRET`. The server stores a hash only and shows the
    /// key once.
    pub secret: String,
}

/// A revoked API key.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RevokedKey {
    /// The key without its secret.
    #[serde(flatten)]
    pub key: KeyView,
    /// Identifiers of all keys that were created by this key, directly or through other keys. They are
    /// revoked with it.
    #[schema(value_type = Vec<String>)]
    pub took_along: Vec<KeyId>,
}
