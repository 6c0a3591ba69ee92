//! How many requests a key may make: a bucket for each key that fills steadily and holds a minute's worth.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};

use crate::api::{KeyId, Problem};

/// The headers of the IETF's draft on rate limits.
const LIMIT: HeaderName = HeaderName::from_static("ratelimit");
const POLICY: HeaderName = HeaderName::from_static("ratelimit-policy");
const MINUTE_MS: i64 = 60_000;

/// The buckets of all keys. Only keys that were found good have one, so that nobody can make many.
pub(super) struct Rates {
    a_minute: Option<u32>,
    buckets: Mutex<HashMap<KeyId, Bucket>>,
}

/// What a key had left at a time, in requests times [`MINUTE_MS`]: whole numbers forget nothing.
struct Bucket {
    left: i64,
    at_ms: i64,
}

/// How a key stands after a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Standing {
    a_minute: u32,
    /// Whole requests that are left.
    left: i64,
    /// Seconds until all are left again.
    full_in: i64,
    /// Seconds until there is one; 0 when this one was.
    wait: i64,
}

impl Rates {
    pub(super) fn new(a_minute: Option<u32>) -> Self {
        Self { a_minute, buckets: Mutex::default() }
    }

    /// Takes a request from the bucket of a key; `None` where there is no limit.
    pub(super) fn take(&self, key: &KeyId, now_ms: i64) -> Option<Standing> {
        let a_minute = self.a_minute?;
        let (rate, most) = (i64::from(a_minute), i64::from(a_minute) * MINUTE_MS);
        let mut buckets = self.buckets.lock().unwrap_or_else(PoisonError::into_inner);
        let bucket = buckets.entry(key.clone()).or_insert(Bucket { left: most, at_ms: now_ms });
        // A clock that was set back fills nothing.
        let passed = (now_ms - bucket.at_ms).clamp(0, MINUTE_MS);
        bucket.left = (bucket.left + passed * rate).min(most);
        bucket.at_ms = now_ms;
        let is_there = bucket.left >= MINUTE_MS;
        bucket.left -= if is_there { MINUTE_MS } else { 0 };
        let seconds = |lacking: i64| ceil(ceil(lacking, rate), 1000);
        let wait = if is_there { 0 } else { seconds(MINUTE_MS - bucket.left) };
        let (left, full_in) = (bucket.left / MINUTE_MS, seconds(most - bucket.left));
        Some(Standing { a_minute, left, full_in, wait })
    }
}

impl Standing {
    /// # Errors
    /// 429 when there was no request left.
    pub(super) fn check(&self) -> Result<(), Problem> {
        if self.wait == 0 {
            return Ok(());
        }
        let detail = format!("this key may make {} requests a minute", self.a_minute);
        Err(Problem::new(StatusCode::TOO_MANY_REQUESTS, "rate-limited", "Too many requests")
            .detail(detail)
            .retry_after(u32::try_from(self.wait).unwrap_or(u32::MAX)))
    }

    /// Says how the key stands.
    pub(super) fn tell(&self, headers: &mut HeaderMap) {
        let lines = [
            (POLICY, format!("\"requests\";q={};w=60", self.a_minute)),
            (LIMIT, format!("\"requests\";r={};t={}", self.left, self.full_in)),
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

    #[test]
    fn a_bucket_fills_steadily_and_holds_a_minutes_worth() {
        let rates = Rates::new(Some(3));
        let key = KeyId::from("a");
        let take = |at_ms: i64| {
            let s = rates.take(&key, at_ms).unwrap();
            (s.left, s.full_in, s.wait)
        };
        assert_eq!([take(0), take(0), take(0)], [(2, 20, 0), (1, 40, 0), (0, 60, 0)]);
        assert_eq!(take(0), (0, 60, 20));
        assert_eq!(take(19_999), (0, 41, 1), "one is there after a third of a minute");
        assert_eq!(take(20_000), (0, 60, 0), "and what was refused took none");
        assert_eq!(take(10_000), (0, 60, 20), "a clock that is set back");
        assert_eq!(take(10_000_000), (2, 20, 0), "never more than a minute's worth");
        assert_eq!(rates.take(&KeyId::from("b"), 0).unwrap().left, 2, "each key has its own");
        assert!(Rates::new(None).take(&key, 0).is_none());
    }
}
