//! Clocks and identifiers, which are injected so that tests can control them.

use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// A clock.
pub trait Clock: Send + Sync {
    /// Milliseconds since 1970 UTC.
    fn now_ms(&self) -> i64;

    /// Sets the time of a shared database. Only a [`DatabaseClock`] uses it.
    fn set(&self, _now_ms: i64) {}
}

/// A generator of identifiers.
pub trait Ids: Send + Sync {
    /// A unique string.
    fn fresh(&self) -> String;
}

/// The clock of the machine.
#[derive(Debug, Default)]
pub struct SystemClock;

impl Clock for SystemClock {
    fn now_ms(&self) -> i64 {
        jiff::Timestamp::now().as_millisecond()
    }
}

/// A clock that follows the time of the database, so that leases end at the same time for all servers that share it. Between two
/// calls of [`Clock::set`] it uses the monotonic clock of this machine, which is independent of changes of the date.
#[derive(Debug)]
pub struct DatabaseClock {
    start: Instant,
    /// Time of the database at `start`, milliseconds since 1970 UTC.
    at_start_ms: AtomicI64,
}

impl DatabaseClock {
    /// A clock whose current time is `now_ms`.
    pub fn new(now_ms: i64) -> Self {
        Self { start: Instant::now(), at_start_ms: AtomicI64::new(now_ms) }
    }

    fn elapsed_ms(&self) -> i64 {
        i64::try_from(self.start.elapsed().as_millis()).unwrap_or(i64::MAX)
    }
}

impl Clock for DatabaseClock {
    fn now_ms(&self) -> i64 {
        self.at_start_ms.load(Ordering::SeqCst).saturating_add(self.elapsed_ms())
    }

    fn set(&self, now_ms: i64) {
        self.at_start_ms.store(now_ms.saturating_sub(self.elapsed_ms()), Ordering::SeqCst);
    }
}

/// Version 7 UUIDs: unguessable, and sorted by time.
#[derive(Debug, Default)]
pub struct RandomIds;

impl Ids for RandomIds {
    fn fresh(&self) -> String {
        uuid::Uuid::now_v7().to_string()
    }
}

/// A clock that only [`ManualClock::advance`] advances.
#[derive(Debug, Default)]
pub struct ManualClock(AtomicI64);

impl ManualClock {
    /// Advances the clock.
    pub fn advance(&self, by: Duration) {
        self.0.fetch_add(i64::try_from(by.as_millis()).unwrap_or(i64::MAX), Ordering::SeqCst);
    }
}

impl Clock for ManualClock {
    fn now_ms(&self) -> i64 {
        self.0.load(Ordering::SeqCst)
    }
}

/// Identifiers `id-00000001`, `id-00000002`, ...
#[derive(Debug, Default)]
pub struct SequentialIds(AtomicU64);

impl Ids for SequentialIds {
    fn fresh(&self) -> String {
        format!("id-{:08}", self.0.fetch_add(1, Ordering::SeqCst) + 1)
    }
}
