//! Threads that decode uploads. They are separate from those of the engine, so that frames do not wait for them, and their number
//! is limited by the memory. Tenants take turns: work of one tenant waits for at most one piece of work of each other tenant.

use std::panic::AssertUnwindSafe;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::server::problem::Problem;
use crate::server::tenant_queue::TenantQueue;
use crate::server::thread_priority::lower_for_this_thread;
use relume_api::TenantId;

/// Maximum bytes for decoding one photograph: as stored, as floats, and reduced.
const ONE_PHOTOGRAPH: u64 = 1600 << 20;

type Work = Box<dyn FnOnce() + Send>;

/// The decoding threads, and the work that waits for them.
#[derive(Clone)]
pub(super) struct Decoders {
    threads: Arc<rayon::ThreadPool>,
    /// Work that has not begun.
    waiting: Arc<Mutex<TenantQueue<Work>>>,
}

impl Decoders {
    /// Starts at most half as many threads as processors, and no more than can decode the largest photographs in a quarter of
    /// `memory` bytes; at least one.
    ///
    /// # Errors
    /// When threads cannot be started.
    pub(super) fn start(memory: u64) -> std::io::Result<Self> {
        Self::with_pool(memory, rayon::ThreadPoolBuilder::new().thread_name(|i| format!("decoder-{i}")))
    }

    /// As [`Self::start`], with threads that give way to trainings and frames.
    ///
    /// # Errors
    /// When threads cannot be started.
    pub(super) fn start_at_low_priority(memory: u64) -> std::io::Result<Self> {
        let pool = rayon::ThreadPoolBuilder::new().thread_name(|i| format!("decoder-low-{i}"));
        Self::with_pool(memory, pool.start_handler(|_| lower_for_this_thread()))
    }

    fn with_pool(memory: u64, pool: rayon::ThreadPoolBuilder) -> std::io::Result<Self> {
        let threads = threads(memory, std::thread::available_parallelism().map_or(1, usize::from));
        let pool = pool.num_threads(threads).build().map_err(std::io::Error::other)?;
        Ok(Self { threads: Arc::new(pool), waiting: Arc::default() })
    }

    /// Runs `work` of `tenant` on the threads, including its parallel parts, when it is the tenant's turn. Work whose caller no
    /// longer waits when its turn comes is left out.
    ///
    /// # Errors
    /// 500 if `work` panics.
    pub(super) async fn run<T: Send + 'static>(
        &self,
        tenant: &TenantId,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        let (answer, answered) = tokio::sync::oneshot::channel();
        let work = move || {
            if !answer.is_closed() {
                // The client may disconnect in the meantime.
                let _ = answer.send(std::panic::catch_unwind(AssertUnwindSafe(work)));
            }
        };
        self.waiting().push(tenant, Box::new(work));
        let decoders = self.clone();
        // One task for each piece of work. The task takes the work whose turn it is when a thread is free.
        self.threads.spawn(move || {
            let next = decoders.waiting().pop();
            if let Some(work) = next {
                work();
            }
        });
        match answered.await {
            Ok(Ok(value)) => Ok(value),
            Ok(Err(_)) | Err(_) => Err(Problem::internal("decoding panicked")),
        }
    }

    fn waiting(&self) -> MutexGuard<'_, TenantQueue<Work>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
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
        let tenant = TenantId::from("a");
        let names = || {
            let name = |_| std::thread::current().name().unwrap_or_default().to_owned();
            (0..100).into_par_iter().map(name).collect::<Vec<_>>()
        };
        let inside = decoders.run(&tenant, names).await.unwrap();
        assert!(inside.iter().all(|name| name == "decoder-0"), "{inside:?}");
        assert!(!names().contains(&"decoder-0".to_owned()), "the control");
        assert_eq!(decoders.run(&tenant, || panic!("broken")).await.map(|()| 0).unwrap_err().status, 500);
        assert_eq!(decoders.run(&tenant, || 7).await.unwrap(), 7, "the threads continue after a panic");
    }

    #[tokio::test]
    async fn tenants_take_turns_and_forgotten_work_is_left_out() {
        let decoders = Decoders::start(1 << 30).unwrap();
        let (a, b) = (TenantId::from("a"), TenantId::from("b"));
        let done = Arc::new(Mutex::new(Vec::new()));
        // Holds the only thread until all other work waits.
        let (release, held) = std::sync::mpsc::channel::<()>();
        let (begin, begun) = tokio::sync::oneshot::channel();
        let first = decoders.run(&a, move || {
            begin.send(()).unwrap();
            held.recv()
        });
        let note = |name: &'static str| {
            let done = done.clone();
            move || done.lock().unwrap().push(name)
        };
        let others = async {
            begun.await.unwrap();
            let mut of_a: Vec<_> =
                ["a1", "a2", "a3"].map(|name| Box::pin(decoders.run(&a, note(name)))).into();
            let mut of_b: Vec<_> = ["b1", "b2"].map(|name| Box::pin(decoders.run(&b, note(name)))).into();
            // The first poll queues the work.
            for work in of_a.iter_mut().chain(&mut of_b) {
                assert!(futures::poll!(work).is_pending());
            }
            // The caller of a2 no longer waits.
            drop(of_a.remove(1));
            release.send(()).unwrap();
            for work in of_b.into_iter().chain(of_a) {
                work.await.unwrap();
            }
        };
        let (first, ()) = tokio::join!(first, others);
        assert!(first.unwrap().is_ok());
        assert_eq!(*done.lock().unwrap(), ["a1", "b1", "b2", "a3"]);
    }
}
