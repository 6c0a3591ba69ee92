//! The retry schedule of failed messages.

use std::time::Duration;

use sha2::{Digest, Sha256};

use relume_api::DeliveryId;

/// Delays before the second attempt, the third, ..., seconds: three days in total.
const RETRY_DELAYS_S: [u64; 9] = [5, 300, 1800, 7200, 18_000, 36_000, 50_400, 72_000, 86_400];

/// The delay after `tries` attempts; `None` if no further attempt follows. Up to a fifth is added, derived
/// from the identifier, so that messages that failed together are not retried together.
pub(super) fn retry_delay(id: &DeliveryId, tries: i64) -> Option<Duration> {
    let place = usize::try_from(tries).ok()?.checked_sub(1)?;
    let retry_delay = Duration::from_secs(*RETRY_DELAYS_S.get(place)?);
    let drawn = Sha256::digest(format!("{id} {tries}"))[0];
    Some(retry_delay + retry_delay.mul_f64(0.2 * f64::from(drawn) / 255.0))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn retry_delays_grow_for_three_days_with_jitter() {
        for id in ["a", "b", "c"].map(DeliveryId::from) {
            let gaps: Vec<Duration> = (1..=9).map(|tries| retry_delay(&id, tries).unwrap()).collect();
            assert!(gaps.is_sorted(), "{gaps:?}");
            assert!(gaps.iter().sum::<Duration>() > Duration::from_secs(3 * 24 * 3600));
            assert_eq!(retry_delay(&id, 10), None);
            assert_eq!(retry_delay(&id, 0), None);
            assert_eq!(retry_delay(&id, 4), retry_delay(&id, 4), "the same each time");
        }
        let drawn: BTreeSet<Duration> =
            (0..64).map(|n| retry_delay(&n.to_string().into(), 3).unwrap()).collect();
        assert!(drawn.len() > 32);
        let bounds = (Duration::from_secs(1800), Duration::from_secs(2160));
        assert!(*drawn.first().unwrap() >= bounds.0 && *drawn.last().unwrap() <= bounds.1, "{drawn:?}");
    }
}
