//! Threads that decode uploads. They are separate from those of the engine, so that frames do not wait for them, and their number
//! is limited by the memory.

use std::sync::Arc;

use crate::server::problem::Problem;

/// Maximum bytes for decoding one photograph: as stored, as floats, and reduced.
const ONE_PHOTOGRAPH: u64 = 1600 << 20;

/// The decoding threads.
#[derive(Clone)]
pub(super) struct Decoders(Arc<rayon::ThreadPool>);

impl Decoders {
    /// Starts at most half as many threads as processors, and no more than can decode the largest photographs in a quarter of
    /// `memory` bytes; at least one.
    ///
    /// # Errors
    /// When threads cannot be started.
    pub(super) fn start(memory: u64) -> std::io::Result<Self> {
        let threads = threads(memory, std::thread::available_parallelism().map_or(1, usize::from));
        let pool =
            rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("decoder-{i}"));
        Ok(Self(Arc::new(pool.build().map_err(std::io::Error::other)?)))
    }

    /// Runs `work` on the threads, including its parallel parts.
    ///
    /// # Errors
    /// 500 if `work` panics.
    pub(super) async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let (answer, answered) = tokio::sync::oneshot::channel();
        self.0.spawn(move || {
            let done = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
            // The client may have disconnected.
            let _ = answer.send(done);
        });
        match answered.await {
            Ok(Ok(value)) => Ok(value),
            Ok(Err(_)) | Err(_) => Err(Problem::internal("decoding panicked")),
        }
    }
}

fn threads(memory: u64, processors: usize) -> usize {
    let with_memory = usize::try_from(memory / 4 / ONE_PHOTOGRAPH).unwrap_or(usize::MAX);
    (processors / 2).min(with_memory).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    #[test]
    fn decoder_threads_are_limited_by_processors_and_memory() {
        assert_eq!(threads(64 << 30, 16), 8);
        assert_eq!(threads(16 << 30, 16), 2);
        assert_eq!(threads(1 << 30, 2), 1);
    }

    #[tokio::test]
    async fn decoder_work_stays_on_its_threads_and_a_panic_answers_500() {
        let decoders = Decoders::start(1 << 30).unwrap();
        let names = || {
            let name = |_| std::thread::current().name().unwrap_or_default().to_owned();
            (0..100).into_par_iter().map(name).collect::<Vec<_>>()
        };
        let inside = decoders.run(names).await.unwrap();
        assert!(inside.iter().all(|name| name == "decoder-0"), "{inside:?}");
        assert!(!names().contains(&"decoder-0".to_owned()), "the control");
        assert_eq!(decoders.run(|| panic!("broken")).await.map(|()| 0).unwrap_err().status, 500);
        assert_eq!(decoders.run(|| 7).await.unwrap(), 7, "the threads continue after a panic");
    }
}
