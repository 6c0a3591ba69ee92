//! The latency of thumbnails.

use std::time::{Duration, Instant};

use crate::cli::bench::quantiles::Quantiles;
use crate::cli::bench::service::fixture::Fixture;
use relume_api::ModelId;
use relume_client::Client;

/// Timeout of one thumbnail.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(30);

/// Requests thumbnails of one model, each from another direction, so that none is cached.
pub(super) struct Thumbnails {
    client: Client,
    model: ModelId,
    size: u32,
    asked: u32,
}

/// The measurements under one load.
#[derive(Debug, Default)]
pub(super) struct Times {
    /// Milliseconds of each answer.
    pub(super) answers: Quantiles,
    /// Thumbnails that were refused or timed out.
    pub(super) refused: usize,
}

impl Thumbnails {
    pub(super) fn new(fixture: &Fixture, size: u32) -> Self {
        Self { client: fixture.client.clone(), model: fixture.model.clone(), size, asked: 0 }
    }

    /// Requests the next thumbnail. Returns its milliseconds; `None` if the server sent no image.
    pub(super) async fn next(&mut self) -> Option<f64> {
        self.asked += 1;
        let azimuth = f64::from(self.asked) * 0.01;
        let query = format!("env=studio&size={}&azimuth={azimuth:.2}", self.size);
        let begin = Instant::now();
        let answer = tokio::time::timeout(ANSWER_TIMEOUT, self.client.thumbnail(&self.model, &query)).await;
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

    /// Requests thumbnails one after the other: at least one, at most `count`, for at most `time`.
    pub(super) async fn during(&mut self, count: u32, time: Duration) -> Times {
        let (begin, mut answers, mut refused) = (Instant::now(), Vec::new(), 0);
        for _ in 0..count {
            match self.next().await {
                Some(ms) => answers.push(ms),
                None => refused += 1,
            }
            if begin.elapsed() >= time {
                break;
            }
        }
        Times { answers: Quantiles::of(answers), refused }
    }
}
