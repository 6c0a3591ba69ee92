//! How long thumbnails take.

use std::time::{Duration, Instant};

use crate::api::ModelId;
use crate::cli::bench::service::subject::Subject;
use crate::client::Client;

/// How long one thumbnail is waited for.
const PATIENCE: Duration = Duration::from_secs(30);

/// Asks for thumbnails of one model, each from another direction, so that no cache has it.
pub(super) struct Thumbnails {
    client: Client,
    model: ModelId,
    size: u32,
    asked: u32,
}

/// What was measured under one load.
#[derive(Debug, Default)]
pub(super) struct Times {
    /// Milliseconds of each answer, ascending.
    ms: Vec<f64>,
    /// Thumbnails that were refused or not answered in time.
    pub(super) refused: usize,
}

impl Thumbnails {
    pub(super) fn new(subject: &Subject, size: u32) -> Self {
        Self { client: subject.client.clone(), model: subject.model.clone(), size, asked: 0 }
    }

    /// Milliseconds of the next one; `None` when there was no picture.
    pub(super) async fn next(&mut self) -> Option<f64> {
        self.asked += 1;
        let azimuth = f64::from(self.asked) * 0.01;
        let query = format!("env=studio&size={}&azimuth={azimuth:.2}", self.size);
        let begin = Instant::now();
        let answer = tokio::time::timeout(PATIENCE, self.client.thumbnail(&self.model, &query)).await;
        let ms = begin.elapsed().as_secs_f64() * 1e3;
        match answer {
            Ok(Ok(_)) => Some(ms),
            Ok(Err(error)) => {
                eprintln!("a thumbnail was refused: {error}");
                None
            }
            Err(_) => None,
        }
    }

    /// One after the other, at most `count` and for at most `time`; at least one.
    pub(super) async fn during(&mut self, count: u32, time: Duration) -> Times {
        let (begin, mut times) = (Instant::now(), Times::default());
        for _ in 0..count {
            match self.next().await {
                Some(ms) => times.ms.push(ms),
                None => times.refused += 1,
            }
            if begin.elapsed() >= time {
                break;
            }
        }
        times.ms.sort_by(f64::total_cmp);
        times
    }
}

impl Times {
    /// Thumbnails that came.
    pub(super) fn answered(&self) -> usize {
        self.ms.len()
    }

    /// The least time, ms, within which at least this share of the answers came.
    pub(super) fn quantile(&self, share: f64) -> Option<f64> {
        let rank = (share * self.ms.len() as f64).ceil() as usize;
        self.ms.get(rank.saturating_sub(1)).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_times_within_which_a_share_was_answered() {
        let times = Times { ms: (1..=200).map(f64::from).collect(), refused: 0 };
        let found = [0.5, 0.95, 0.99, 1.0].map(|share| times.quantile(share));
        assert_eq!(found, [100.0, 190.0, 198.0, 200.0].map(Some));
        let one = Times { ms: vec![7.0], refused: 3 };
        assert_eq!((one.quantile(0.5), one.quantile(1.0)), (Some(7.0), Some(7.0)));
        assert_eq!(Times::default().quantile(0.99), None);
    }
}
