//! Measured time per unit of cost, with more weight on the recent past.

/// Time per unit of cost.
#[derive(Debug, Clone, Copy)]
pub struct Rate {
    seconds: f64,
    cost: f64,
    /// Seconds after which a measurement has 1/e of its weight.
    memory: f64,
}

impl Rate {
    /// A rate without measurements; `memory` is the time after which a measurement has 1/e of its weight, seconds.
    pub fn new(memory: f64) -> Self {
        Self { seconds: 0.0, cost: 0.0, memory: memory.max(1e-3) }
    }

    /// Records that work of `cost` took `seconds`. A value that is not finite or not positive is ignored.
    pub fn record(&mut self, seconds: f64, cost: f64) {
        if !(seconds.is_finite() && cost.is_finite() && seconds >= 0.0 && cost > 0.0) {
            return;
        }
        let keep = (-seconds / self.memory).exp();
        self.seconds = self.seconds * keep + seconds;
        self.cost = self.cost * keep + cost;
    }

    /// Seconds per unit of cost; `None` without a measurement.
    pub fn per_cost(&self) -> Option<f64> {
        (self.cost > 0.0).then(|| self.seconds / self.cost)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_follows_the_recent_past_and_ignores_nan() {
        let mut rate = Rate::new(2.0);
        assert_eq!(rate.per_cost(), None);
        rate.record(f64::NAN, 1.0);
        rate.record(1.0, f64::NAN);
        rate.record(1.0, 0.0);
        assert_eq!(rate.per_cost(), None);
        (0..100).for_each(|_| rate.record(0.1, 1.0));
        assert!((rate.per_cost().unwrap() - 0.1).abs() < 1e-9);
        (0..40).for_each(|_| rate.record(0.2, 1.0));
        let now = rate.per_cost().unwrap();
        assert!((0.19..=0.2).contains(&now), "{now}");
        let mut free = Rate::new(2.0);
        free.record(0.0, 1.0);
        assert_eq!(free.per_cost(), Some(0.0), "work that takes no time");
    }
}
