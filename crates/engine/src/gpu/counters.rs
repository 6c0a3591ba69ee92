//! Counts of a device's work.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Running counts of a device.
#[derive(Debug, Default)]
pub(super) struct DeviceCounters {
    /// Number of kernel dispatches.
    pub(super) dispatches: AtomicU64,
    /// Number of submissions.
    pub(super) submitted: AtomicU64,
    /// Number of the last submission known to be complete.
    pub(super) completed: AtomicU64,
    /// Maximum number of submissions in flight, i.e. not known to be complete.
    max_in_flight: AtomicU64,
    /// Number of waits for the device; the next field has their nanoseconds.
    waits: AtomicU64,
    waited_ns: AtomicU64,
    /// Nanoseconds spent in submission.
    submitting_ns: AtomicU64,
}

/// Counts of a device since it was opened; the difference of two gives the counts between them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DeviceCounts {
    /// Number of kernel dispatches.
    pub dispatches: u64,
    /// Number of submissions.
    pub submissions: u64,
    /// Number of waits of a thread for the device.
    pub waits: u64,
    /// Total time of the waits.
    pub waited: Duration,
    /// Total time of submission; some drivers execute the work in it.
    pub submitting: Duration,
}

impl DeviceCounters {
    /// Counts a submission with its dispatches and its submission time; returns its number, from 1.
    pub(super) fn submit(&self, dispatches: u32, time: Duration) -> u64 {
        self.submitting_ns.fetch_add(time.as_nanos() as u64, Ordering::Relaxed);
        self.dispatches.fetch_add(u64::from(dispatches), Ordering::Relaxed);
        let number = self.submitted.fetch_add(1, Ordering::Relaxed) + 1;
        let ahead = number.saturating_sub(self.completed.load(Ordering::Relaxed));
        self.max_in_flight.fetch_max(ahead, Ordering::Relaxed);
        number
    }

    pub(super) fn waited(&self, time: Duration) {
        self.waits.fetch_add(1, Ordering::Relaxed);
        self.waited_ns.fetch_add(time.as_nanos() as u64, Ordering::Relaxed);
    }

    pub(super) fn counts(&self) -> DeviceCounts {
        let of = |count: &AtomicU64| count.load(Ordering::Relaxed);
        DeviceCounts {
            dispatches: of(&self.dispatches),
            submissions: of(&self.submitted),
            waits: of(&self.waits),
            waited: Duration::from_nanos(of(&self.waited_ns)),
            submitting: Duration::from_nanos(of(&self.submitting_ns)),
        }
    }

    /// Maximum number of submissions in flight since the last call.
    #[cfg(test)]
    pub(super) fn take_max_in_flight(&self) -> u64 {
        self.max_in_flight.swap(0, Ordering::Relaxed)
    }
}

impl std::ops::Sub for DeviceCounts {
    type Output = Self;

    fn sub(self, earlier: Self) -> Self {
        Self {
            dispatches: self.dispatches - earlier.dispatches,
            submissions: self.submissions - earlier.submissions,
            waits: self.waits - earlier.waits,
            waited: self.waited.saturating_sub(earlier.waited),
            submitting: self.submitting.saturating_sub(earlier.submitting),
        }
    }
}
