//! Quantiles of repeated time measurements.

/// Times in ascending order.
#[derive(Debug, Default)]
pub(super) struct Quantiles(Vec<f64>);

impl Quantiles {
    /// Sorts the times.
    pub(super) fn of(mut times: Vec<f64>) -> Self {
        times.sort_by(f64::total_cmp);
        Self(times)
    }

    /// The number of times.
    pub(super) fn count(&self) -> usize {
        self.0.len()
    }

    /// The smallest time within which at least this share of the operations ended; `None` if there are no times.
    pub(super) fn at(&self, share: f64) -> Option<f64> {
        let rank = (share * self.0.len() as f64).ceil() as usize;
        self.0.get(rank.saturating_sub(1)).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_use_the_nearest_rank() {
        let times = Quantiles::of((1..=200).rev().map(f64::from).collect());
        let found = [0.5, 0.95, 0.99, 1.0].map(|share| times.at(share));
        assert_eq!(found, [100.0, 190.0, 198.0, 200.0].map(Some));
        let one = Quantiles::of(vec![7.0]);
        assert_eq!((one.at(0.5), one.at(1.0), one.count()), (Some(7.0), Some(7.0), 1));
        assert_eq!(Quantiles::default().at(0.99), None);
    }
}
