//! Threads that decode uploads. They are separate from those of the engine, so that frames do not wait for them, and their number
//! is limited by the memory. Tenants take turns: work of one tenant waits for at most one piece of work of each other tenant.

use std::collections::{HashMap, VecDeque};
use std::panic::AssertUnwindSafe;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::server::problem::Problem;
use relume_api::TenantId;

/// Maximum bytes for decoding one photograph: as stored, as floats, and reduced.
const ONE_PHOTOGRAPH: u64 = 1600 << 20;

type Work = Box<dyn FnOnce() + Send>;

/// The decoding threads, and the work that waits for them.
#[derive(Clone)]
pub(super) struct Decoders {
    threads: Arc<rayon::ThreadPool>,
    waiting: Arc<Mutex<Waiting>>,
}

/// Work that has not begun.
#[derive(Default)]
struct Waiting {
    /// The tenants with work, in the order of their turns.
    turns: VecDeque<TenantId>,
    work: HashMap<TenantId, VecDeque<Work>>,
}

impl Waiting {
    fn push(&mut self, tenant: &TenantId, work: Work) {
        let of_tenant = self.work.entry(tenant.clone()).or_default();
        if of_tenant.is_empty() {
            self.turns.push_back(tenant.clone());
        }
        of_tenant.push_back(work);
    }

    /// The oldest work of the tenant whose turn it is. Its next turn comes after those of all other tenants.
    fn pop(&mut self) -> Option<Work> {
        let tenant = self.turns.pop_front()?;
        let of_tenant = self.work.get_mut(&tenant)?;
        let work = of_tenant.pop_front();
        if of_tenant.is_empty() {
            self.work.remove(&tenant);
        } else {
            self.turns.push_back(tenant);
        }
        work
    }
}

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
        Ok(Self { threads: Arc::new(pool.build().map_err(std::io::Error::other)?), waiting: Arc::default() })
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

    fn waiting(&self) -> MutexGuard<'_, Waiting> {
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
        let waiting = decoders.waiting();
        assert!(waiting.turns.is_empty() && waiting.work.is_empty(), "tenants without work have no entry");
    }
}
