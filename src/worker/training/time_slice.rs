//! The time slice of an attempt, after which it gives way to waiting jobs.

/// Minimum time slice, milliseconds.
const MIN_SLICE_MS: i64 = 30_000;
/// Minimum time slice as a multiple of the time before the first step, which the next attempt needs again.
const PREPARATIONS: i64 = 4;
/// Time between two questions whether a job waits, milliseconds.
const INTERVAL_MS: i64 = 1000;

/// Decides when an attempt asks whether it should give way.
pub(super) struct TimeSlice {
    last_ms: i64,
    left_ms: i64,
}

impl TimeSlice {
    /// The slice of an attempt that took its first step at `now_ms`, after `preparation_ms`.
    pub(super) fn new(now_ms: i64, preparation_ms: i64) -> Self {
        Self { last_ms: now_ms, left_ms: (PREPARATIONS * preparation_ms).max(MIN_SLICE_MS) }
    }

    /// Whether to ask at `now_ms`: when the slice is over, then once an interval. A clock that was set back does not extend the slice.
    pub(super) fn is_over(&mut self, now_ms: i64) -> bool {
        self.left_ms -= (now_ms - self.last_ms).max(0);
        self.last_ms = now_ms;
        let is_over = self.left_ms <= 0;
        if is_over {
            self.left_ms = INTERVAL_MS;
        }
        is_over
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slices_cover_the_preparation_several_times() {
        let ends_after = |preparation| {
            let mut slice = TimeSlice::new(0, preparation);
            (0..).map(|second| second * 1000).find(|ms| slice.is_over(*ms)).unwrap()
        };
        assert_eq!([ends_after(0), ends_after(1000), ends_after(20_000)], [30_000, 30_000, 80_000]);
    }

    #[test]
    fn a_slice_that_is_over_asks_once_an_interval() {
        let mut slice = TimeSlice::new(0, 0);
        let asked = [29_999, 30_000, 30_500, 31_000, 31_001].map(|ms| slice.is_over(ms));
        assert_eq!(asked, [false, true, false, true, false]);
    }

    #[test]
    fn a_clock_that_is_set_back_does_not_extend_a_slice() {
        let mut slice = TimeSlice::new(1_000_000, 0);
        let asked = [1_020_000, 0, 9_000, 10_000].map(|ms| slice.is_over(ms));
        assert_eq!(asked, [false, false, false, true]);
    }
}
