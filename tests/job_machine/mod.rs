//! The job state machine against a model: random histories of operations of clients and workers. After every
//! step the jobs, leases, events and files must equal those of the model.

mod history;
mod model;

use std::sync::atomic::{AtomicU64, Ordering};

use history::Bench;
use model::Wrong;

/// Default number of histories; `RELUME_JOB_HISTORIES` sets another.
const HISTORIES: u64 = 10_000;
/// Number of histories within which each wrong model is detected.
const CONTROLS: u64 = 2_000;

fn histories() -> u64 {
    std::env::var("RELUME_JOB_HISTORIES").map_or(HISTORIES, |count| count.parse().unwrap())
}

/// Runs histories `0..count`, each with its number as the seed, until one differs from the model. Returns the
/// number of equal histories, or the difference.
fn run(count: u64, wrong: Option<Wrong>) -> Result<u64, String> {
    let next = AtomicU64::new(0);
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(8);
    let worker = || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let mut bench = Bench::new().await;
            loop {
                let seed = next.fetch_add(1, Ordering::SeqCst);
                if seed >= count {
                    return Ok(());
                }
                if let Err(difference) = bench.history(seed, wrong).await {
                    next.store(count, Ordering::SeqCst);
                    return Err(format!("history {seed}: {difference}"));
                }
            }
        })
    };
    std::thread::scope(|scope| {
        let running: Vec<_> = (0..threads).map(|_| scope.spawn(worker)).collect();
        running.into_iter().try_for_each(|thread| thread.join().unwrap())
    })?;
    Ok(count)
}

#[test]
fn ten_thousand_random_job_histories_match_the_model() {
    let count = histories();
    assert_eq!(run(count, None), Ok(count));
}

#[test]
fn a_wrong_model_of_the_queue_is_detected() {
    for wrong in Wrong::ALL {
        let found = run(CONTROLS, Some(wrong));
        assert!(found.is_err(), "{wrong:?} agrees with {CONTROLS} histories");
    }
}
