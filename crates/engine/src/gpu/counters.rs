//! What a device was asked for, counted.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Running counts of a device.
#[derive(Debug, Default)]
pub(super) struct DeviceCounters {
    /// Dispatches of kernels.
    pub(super) dispatches: AtomicU64,
    /// Submissions.
    pub(super) submitted: AtomicU64,
    /// The last submission that is known to be done.
    pub(super) completed: AtomicU64,
    /// Most submissions that were not known to be done.
    max_in_flight: AtomicU64,
    /// Waits for the device, and nanoseconds spent in them.
    waits: AtomicU64,
    waited_ns: AtomicU64,
    /// Nanoseconds spent handing work over.
    submitting_ns: AtomicU64,
}

/// What a device was asked for since it was opened; differences of two of them tell what lies between.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DeviceCounts {
    /// Dispatches of kernels.
    pub dispatches: u64,
    /// Submissions of recorded work.
    pub submissions: u64,
    /// Times that a thread waited for the device.
    pub waits: u64,
    /// How long these took in all.
    pub waited: Duration,
    /// How long submitting took in all; some drivers do the work meanwhile.
    pub submitting: Duration,
}

impl DeviceCounters {
    /// Counts a submission with its dispatches, that took so long to hand over; gives its number, from 1.
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

    /// Most submissions that were not known to be done since this was last asked.
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
