//! Time and identifiers, injected so that tests decide both.

use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Tells the time.
pub trait Clock: Send + Sync {
    /// Milliseconds since 1970 UTC.
    fn now_ms(&self) -> i64;

    /// Tells it the time of a database that several servers share. Only a [`DatabaseClock`] follows that.
    fn set(&self, _now_ms: i64) {}
}

/// Makes identifiers.
pub trait Ids: Send + Sync {
    /// A string that was never returned before.
    fn fresh(&self) -> String;
}

/// The machine's clock.
#[derive(Debug, Default)]
pub struct SystemClock;

impl Clock for SystemClock {
    fn now_ms(&self) -> i64 {
        jiff::Timestamp::now().as_millisecond()
    }
}

/// A clock that goes with that of the database, whatever this machine's says: leases end at the same time for everybody who shares
/// the database. Between two [`Clock::set`] it goes on by this machine's time since its start, which no change of the date moves.
#[derive(Debug)]
pub struct DatabaseClock {
    start: Instant,
    /// Time of the database at `start`, milliseconds since 1970 UTC.
    at_start_ms: AtomicI64,
}

impl DatabaseClock {
    /// A clock that says `now_ms` now.
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

/// UUIDs of version 7: unguessable, and sorted by time.
#[derive(Debug, Default)]
pub struct RandomIds;

impl Ids for RandomIds {
    fn fresh(&self) -> String {
        uuid::Uuid::now_v7().to_string()
    }
}

/// A clock that only [`ManualClock::advance`] moves.
#[derive(Debug, Default)]
pub struct ManualClock(AtomicI64);

impl ManualClock {
    /// Moves the clock on.
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
