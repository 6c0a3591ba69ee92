//! The pace of deletion by age. A clock that is set forward by years makes everything old at once, and deletion cannot be undone.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use crate::store::ExpiryCounts;

/// Difference between the clock and the monotonic clock, within one check, from which the clock has jumped.
const JUMP: Duration = Duration::from_secs(60);
/// The period for which the share counts.
const DAY: Duration = Duration::from_secs(24 * 3600);

/// Limits of deletion by age.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RetentionPace {
    /// Time after the start of the server, and after a jump of its clock, in which nothing is deleted by age.
    pub delay: Duration,
    /// Maximum share of the resources of each kind that is deleted by age within a day, above 0 and at most 1. At least one
    /// resource of each kind may be deleted.
    pub daily_share: f64,
}

impl RetentionPace {
    /// No limits.
    pub const UNLIMITED: Self = Self { delay: Duration::ZERO, daily_share: 1.0 };
}

impl Default for RetentionPace {
    fn default() -> Self {
        Self { delay: Duration::from_secs(3600), daily_share: 0.25 }
    }
}

/// Decides how many resources may be deleted by age.
pub(super) struct RetentionPacer {
    pace: RetentionPace,
    /// The start of the server, or the last jump of the clock.
    quiet_since: Instant,
    /// The last check, and the clock at that time, milliseconds since 1970 UTC.
    last: Option<(Instant, i64)>,
    /// The deletions of the last day.
    deleted: VecDeque<(Instant, ExpiryCounts)>,
}

impl RetentionPacer {
    /// A server that starts at `now`.
    pub(super) fn new(pace: RetentionPace, now: Instant) -> Self {
        Self { pace, quiet_since: now, last: None, deleted: VecDeque::new() }
    }

    /// Whether resources may be deleted by age at `now`, when the clock says `clock_ms`. Must be called regularly, so that jumps
    /// are noticed.
    pub(super) fn is_quiet(&mut self, now: Instant, clock_ms: i64) -> bool {
        if let Some((then, then_ms)) = self.last.replace((now, clock_ms)) {
            let passed = i64::try_from(now.duration_since(then).as_millis()).unwrap_or(i64::MAX);
            let jump = clock_ms.saturating_sub(then_ms).saturating_sub(passed).unsigned_abs();
            if u128::from(jump) > JUMP.as_millis() {
                tracing::warn!(jump_ms = jump, "the clock jumped; nothing is deleted by age for a while");
                self.quiet_since = now;
            }
        }
        now.duration_since(self.quiet_since) >= self.pace.delay
    }

    /// Maximum number of resources of each kind that may be deleted at `now`, if there are `existing` ones.
    pub(super) fn allowed(&mut self, now: Instant, existing: ExpiryCounts) -> ExpiryCounts {
        while self.deleted.front().is_some_and(|(then, _)| now.duration_since(*then) >= DAY) {
            self.deleted.pop_front();
        }
        let today =
            self.deleted.iter().fold(ExpiryCounts::default(), |sum, (_, n)| sum.zip(*n, |a, b| a + b));
        existing.zip(today, |existing, today| {
            let share = ((existing + today) as f64 * self.pace.daily_share).ceil() as usize;
            share.saturating_sub(today)
        })
    }

    /// Records deletions at `now`.
    pub(super) fn record(&mut self, now: Instant, deleted: ExpiryCounts) {
        if deleted != ExpiryCounts::default() {
            self.deleted.push_back((now, deleted));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MINUTE: Duration = Duration::from_secs(60);

    #[test]
    fn nothing_expires_within_an_hour_of_a_start_or_a_jump() {
        let start = Instant::now();
        let mut pacer = RetentionPacer::new(RetentionPace::default(), start);
        let mut at = |minutes: u32, clock_ms: i64| pacer.is_quiet(start + minutes * MINUTE, clock_ms);
        assert!(!at(0, 0) && !at(59, 59 * 60_000));
        assert!(at(60, 60 * 60_000), "the control: an hour after the start");
        let years = 5 * 365 * 24 * 3600 * 1000;
        assert!(!at(61, 61 * 60_000 + years), "set forward");
        assert!(!at(120, 120 * 60_000 + years));
        assert!(at(121, 121 * 60_000 + years));
        assert!(!at(122, 122 * 60_000), "set back");
        assert!(at(182, 182 * 60_000));
    }

    #[test]
    fn a_share_of_the_resources_expires_per_day() {
        let start = Instant::now();
        let mut pacer = RetentionPacer::new(RetentionPace::default(), start);
        let existing = |jobs| ExpiryCounts { jobs, captures: 1, ..ExpiryCounts::default() };
        let allowed = pacer.allowed(start, existing(100));
        assert_eq!(allowed, ExpiryCounts { jobs: 25, captures: 1, ..ExpiryCounts::default() });
        pacer.record(start, allowed);
        assert_eq!(
            pacer.allowed(start + MINUTE, ExpiryCounts { jobs: 75, ..ExpiryCounts::default() }).jobs,
            0
        );
        assert_eq!(pacer.allowed(start + DAY, existing(75)).jobs, 19, "the control: a day later");
        let mut unlimited = RetentionPacer::new(RetentionPace::UNLIMITED, start);
        assert_eq!(unlimited.allowed(start, existing(100)), existing(100));
    }
}
