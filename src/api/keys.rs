//! API keys: who may call, for which tenant, and to do what.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::api::marks::{NO_CONTROL, has_control};
use crate::api::{KeyId, TenantId};

/// What a key lets its bearer do. No scope contains another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum Scope {
    /// Look at captures, environments, jobs, models, their files and thumbnails; count them.
    Read,
    /// Render frames.
    Render,
    /// Upload, submit and change jobs, delete.
    Submit,
    /// Make, list and revoke keys; webhooks.
    Admin,
    /// Submit jobs with a priority above 0. Only administrators of the tenant `default` give it.
    Priority,
    /// Read `/metrics` and `/v1/workers`; of the tenant `default`.
    Metrics,
    /// Take jobs of all tenants and publish their models, as `relume worker` does; of the tenant `default`.
    Work,
}

impl Scope {
    /// All scopes.
    pub const ALL: [Self; 7] =
        [Self::Read, Self::Render, Self::Submit, Self::Admin, Self::Priority, Self::Metrics, Self::Work];

    /// Whether keys of a tenant can make use of it.
    pub fn is_of(self, tenant: &TenantId) -> bool {
        !matches!(self, Self::Metrics | Self::Work) || tenant.is_operator()
    }

    /// Its name in JSON and on the command line.
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
        found.ok_or_else(|| format!("{text:?} is none of {}", Self::ALL.map(Self::name).join(", ")))
    }
}

impl TenantId {
    /// The tenant of whoever runs the server: of keys that are configured, and of a server without keys. Its
    /// administrators manage the keys of all tenants.
    pub fn of_operator() -> Self {
        Self::from("default")
    }

    /// Whether this is [`TenantId::of_operator`].
    pub fn is_operator(&self) -> bool {
        self.as_str() == "default"
    }

    /// What is wrong with the name, if anything is.
    pub fn fault(&self) -> Option<&'static str> {
        let name = self.as_str();
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || matches!(c, '-' | '.');
        let good = (1..=64).contains(&name.len()) && name.chars().all(plain);
        (!good).then_some("must have 1 to 64 of a-z, 0-9, - and .")
    }
}

/// A key to be made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct NewKey {
    /// A name for people, 1 to 128 characters, none of them control characters.
    #[cfg_attr(feature = "server", schema(min_length = 1, max_length = 128))]
    pub name: String,
    /// Whose it is; the caller's tenant when absent. Only administrators of the tenant `default` may name another.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(
        feature = "server",
        schema(value_type = Option<String>, min_length = 1, max_length = 64, pattern = "^[a-z0-9.-]+$")
    )]
    pub tenant: Option<TenantId>,
    /// What it may do; `metrics` and `work` are for keys of the tenant `default`.
    #[cfg_attr(feature = "server", schema(min_items = 1, max_items = 7))]
    pub scopes: Vec<Scope>,
    /// Seconds until it expires, 1 to ten years; never when absent. It expires with the caller's own key at the latest.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(minimum = 1, maximum = 315_360_000))]
    pub expires_in: Option<u64>,
}

impl NewKey {
    /// Longest life of a key that expires, seconds.
    pub const LONGEST_LIFE: u64 = 10 * 365 * 24 * 3600;

    /// The field that is wrong and what is wrong with it; `caller` is the tenant where none is named.
    pub fn fault(&self, caller: &TenantId) -> Option<(&'static str, String)> {
        if !(1..=128).contains(&self.name.chars().count()) {
            return Some(("name", "must have 1 to 128 characters".to_owned()));
        }
        if has_control(&self.name) {
            return Some(("name", NO_CONTROL.to_owned()));
        }
        if let Some(fault) = self.tenant.as_ref().and_then(TenantId::fault) {
            return Some(("tenant", fault.to_owned()));
        }
        let twice = (1..self.scopes.len()).any(|i| self.scopes[..i].contains(&self.scopes[i]));
        if self.scopes.is_empty() || twice {
            return Some(("scopes", "must name at least one scope, and each once".to_owned()));
        }
        let tenant = self.tenant.as_ref().unwrap_or(caller);
        if let Some(scope) = self.scopes.iter().find(|scope| !scope.is_of(tenant)) {
            let operator = TenantId::of_operator();
            return Some(("scopes", format!("{scope} is for keys of the tenant {operator} alone")));
        }
        if self.expires_in.is_some_and(|s| !(1..=Self::LONGEST_LIFE).contains(&s)) {
            return Some(("expires_in", format!("must be 1 to {} seconds", Self::LONGEST_LIFE)));
        }
        None
    }
}

/// A key, without its secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct KeyView {
    /// Identifier; the second part of the key itself.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub id: KeyId,
    /// A name for people.
    pub name: String,
    /// Whose it is.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub tenant: TenantId,
    /// What it may do.
    pub scopes: Vec<Scope>,
    /// The key that made it, with which it is revoked; absent for those of the command line and of configured keys.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>))]
    pub made_by: Option<KeyId>,
    /// RFC 3339.
    pub created_at: String,
    /// RFC 3339; when it expires.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub expires_at: Option<String>,
    /// RFC 3339; when it was last used, to a minute.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub last_used_at: Option<String>,
    /// RFC 3339; when it was revoked.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub revoked_at: Option<String>,
}

/// A key that was just made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct CreatedKey {
    /// The key as lists show it.
    #[serde(flatten)]
    pub key: KeyView,
    /// What its bearer sends, `rlm_ID_SECRET`. The server keeps a hash of it and never shows it again.
    pub secret: String,
}

/// A key that was revoked.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct RevokedKey {
    /// The key as lists show it.
    #[serde(flatten)]
    pub key: KeyView,
    /// Keys that it made, and those that these made: all are revoked with it.
    #[cfg_attr(feature = "server", schema(value_type = Vec<String>))]
    pub took_along: Vec<KeyId>,
}
