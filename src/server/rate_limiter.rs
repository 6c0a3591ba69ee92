//! Rate limits of keys and tenants: a token bucket for each, which is refilled steadily up to the requests of one minute.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};

use crate::server::caller::Caller;
use crate::server::problem::Problem;
use relume_api::{KeyId, TenantId};

/// The headers of the IETF draft on rate limits.
const LIMIT: HeaderName = HeaderName::from_static("ratelimit");
const POLICY: HeaderName = HeaderName::from_static("ratelimit-policy");
const MINUTE_MS: i64 = 60_000;

/// Default limit of a tenant, in multiples of the limit of a key.
const DEFAULT_KEYS_PER_TENANT: u32 = 10;

/// The buckets of all keys and tenants. Only valid keys have one, so that their number is limited.
pub(super) struct RateLimiter {
    per_minute: Option<u32>,
    tenant_per_minute: Option<u32>,
    buckets: Mutex<TokenBuckets>,
}

#[derive(Default)]
struct TokenBuckets {
    of_keys: HashMap<KeyId, TokenBucket>,
    of_tenants: HashMap<TenantId, TokenBucket>,
}

/// The remaining requests at a time, in units of a request divided by [`MINUTE_MS`], so that integers lose no fraction.
#[derive(Clone, Copy)]
struct TokenBucket {
    per_minute: u32,
    left: i64,
    at_ms: i64,
}

/// The status of a key and its tenant after a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct RateLimitStatus(Vec<BucketStatus>);

/// The status of one bucket.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct BucketStatus {
    /// `requests` for the key, or `tenant`.
    name: &'static str,
    per_minute: u32,
    /// Remaining whole requests.
    left: i64,
    /// Seconds until the bucket is full.
    full_in: i64,
    /// Seconds until the next request is permitted; 0 if this one was permitted.
    wait: i64,
}

impl RateLimiter {
    /// Limits per minute of a key and of a tenant; without the second, ten times the first.
    pub(super) fn new(per_minute: Option<u32>, tenant_per_minute: Option<u32>) -> Self {
        let of_tenant = tenant_per_minute.or(per_minute.map(|n| n.saturating_mul(DEFAULT_KEYS_PER_TENANT)));
        Self { per_minute, tenant_per_minute: of_tenant, buckets: Mutex::default() }
    }

    /// Takes a request from the buckets of the caller's key and tenant, or from neither; `None` without a limit.
    pub(super) fn take(&self, caller: &Caller, now_ms: i64) -> Option<RateLimitStatus> {
        let mut guard = self.buckets.lock().unwrap_or_else(PoisonError::into_inner);
        let buckets = &mut *guard;
        let mut taken: Vec<(&'static str, &mut TokenBucket)> = Vec::new();
        if let Some(per_minute) = self.per_minute {
            let of_key = buckets.of_keys.entry(caller.key.clone());
            taken.push(("requests", of_key.or_insert(TokenBucket::full(per_minute, now_ms))));
        }
        if let Some(per_minute) = self.tenant_per_minute {
            let of_tenant = buckets.of_tenants.entry(caller.tenant.clone());
            taken.push(("tenant", of_tenant.or_insert(TokenBucket::full(per_minute, now_ms))));
        }
        taken.iter_mut().for_each(|(_, bucket)| bucket.fill(now_ms));
        let is_there = taken.iter().all(|(_, bucket)| bucket.left >= MINUTE_MS);
        let statuses: Vec<BucketStatus> = taken.into_iter().map(|(name, b)| b.take(name, is_there)).collect();
        (!statuses.is_empty()).then_some(RateLimitStatus(statuses))
    }
}

impl TokenBucket {
    fn full(per_minute: u32, at_ms: i64) -> Self {
        Self { per_minute, left: i64::from(per_minute) * MINUTE_MS, at_ms }
    }

    fn fill(&mut self, now_ms: i64) {
        let rate = i64::from(self.per_minute);
        // A clock that was set back adds nothing.
        let passed = (now_ms - self.at_ms).clamp(0, MINUTE_MS);
        self.left = (self.left + passed * rate).min(rate * MINUTE_MS);
        self.at_ms = now_ms;
    }

    /// Takes a request if every bucket has one, and returns the status.
    fn take(&mut self, name: &'static str, is_there: bool) -> BucketStatus {
        let rate = i64::from(self.per_minute);
        self.left -= if is_there { MINUTE_MS } else { 0 };
        let seconds = |lacking: i64| ceil(ceil(lacking, rate), 1000);
        let wait = if is_there { 0 } else { seconds((MINUTE_MS - self.left).max(0)) };
        let (left, full_in) = (self.left / MINUTE_MS, seconds(rate * MINUTE_MS - self.left));
        BucketStatus { name, per_minute: self.per_minute, left, full_in, wait }
    }
}

impl RateLimitStatus {
    /// # Errors
    /// 429 if no request was left.
    pub(super) fn check(&self) -> Result<(), Problem> {
        let Some(short) = self.0.iter().filter(|status| status.wait > 0).max_by_key(|status| status.wait)
        else {
            return Ok(());
        };
        let whose = if short.name == "tenant" { "all keys of this tenant together" } else { "this key" };
        let detail = format!("{whose} may make {} requests per minute", short.per_minute);
        Err(Problem::new(StatusCode::TOO_MANY_REQUESTS, "rate-limited", "Too many requests")
            .detail(detail)
            .retry_after(u32::try_from(short.wait).unwrap_or(u32::MAX)))
    }

    /// Writes the status of the key and its tenant.
    pub(super) fn write_headers(&self, headers: &mut HeaderMap) {
        let list = |line: fn(&BucketStatus) -> String| self.0.iter().map(line).collect::<Vec<_>>().join(", ");
        let lines = [
            (POLICY, list(|p| format!("\"{}\";q={};w=60", p.name, p.per_minute))),
            (LIMIT, list(|p| format!("\"{}\";r={};t={}", p.name, p.left, p.full_in))),
        ];
        for (name, text) in lines {
            if let Ok(value) = HeaderValue::from_str(&text) {
                headers.insert(name, value);
            }
        }
    }
}

fn ceil(number: i64, by: i64) -> i64 {
    (number + by - 1) / by
}

#[cfg(test)]
mod tests {
    use super::*;

    fn caller(key: &str, tenant: &str) -> Caller {
        Caller { key: key.into(), tenant: tenant.into(), ..Caller::without_key() }
    }

    fn statuses(rates: &RateLimiter, caller: &Caller, at_ms: i64) -> Vec<(i64, i64, i64)> {
        rates.take(caller, at_ms).unwrap().0.iter().map(|p| (p.left, p.full_in, p.wait)).collect()
    }

    #[test]
    fn rate_limit_refills_steadily_up_to_one_minute_of_requests() {
        let rates = RateLimiter::new(Some(3), None);
        let take = |at_ms: i64| statuses(&rates, &caller("a", "t"), at_ms)[0];
        assert_eq!([take(0), take(0), take(0)], [(2, 20, 0), (1, 40, 0), (0, 60, 0)]);
        assert_eq!(take(0), (0, 60, 20));
        assert_eq!(take(19_999), (0, 41, 1), "one request is added after a third of a minute");
        assert_eq!(take(20_000), (0, 60, 0), "a refused request takes nothing");
        assert_eq!(take(10_000), (0, 60, 20), "a clock that is set back");
        assert_eq!(take(10_000_000), (2, 20, 0), "at most the requests of one minute");
        assert_eq!(statuses(&rates, &caller("b", "t"), 0)[0].0, 2, "each key has its own bucket");
        assert!(RateLimiter::new(None, None).take(&caller("a", "t"), 0).is_none());
    }

    #[test]
    fn several_keys_share_the_rate_limit_of_their_tenant() {
        let rates = RateLimiter::new(Some(2), Some(3));
        let take = |key: &str, tenant: &str| statuses(&rates, &caller(key, tenant), 0);
        assert_eq!(take("a", "t"), [(1, 30, 0), (2, 20, 0)]);
        take("a", "t");
        assert_eq!(
            take("a", "t"),
            [(0, 60, 30), (1, 40, 0)],
            "a request that the key refuses takes nothing from the tenant"
        );
        assert_eq!(take("b", "t"), [(1, 30, 0), (0, 60, 0)]);
        assert_eq!(take("c", "t"), [(2, 0, 0), (0, 60, 20)], "a new key does not raise the tenant's limit");
        assert_eq!(take("c", "u"), [(1, 30, 0), (2, 20, 0)], "another tenant has its own bucket");
        let by_default = RateLimiter::new(Some(2), None);
        let made = (0..12).map(|n| by_default.take(&caller(&n.to_string(), "t"), 0).unwrap());
        assert_eq!(made.filter(|standing| standing.check().is_ok()).count(), 12);
        let more = (0..12).map(|n| by_default.take(&caller(&n.to_string(), "t"), 0).unwrap());
        assert_eq!(more.filter(|standing| standing.check().is_ok()).count(), 8, "twenty in total");
    }
}
