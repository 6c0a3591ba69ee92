//! The in-process worker: one OS thread that owns the device, trains what is queued and renders between steps.
//!
//! The thread drives one future with `block_on`, so that a training step may take as long as it likes without
//! stalling the server, and nothing else ever touches the device.

mod device;
mod lru;
mod progress;
mod renders;
mod training;
mod view;

use std::panic::AssertUnwindSafe;
use std::thread::JoinHandle;
use std::time::Duration;

use futures::FutureExt;
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

pub use device::{Device, RenderFailure};
pub use renders::{LightSource, ModelSource, RenderTask};
pub use training::import_for_training;
pub use view::{Orbit, View};

use crate::jobs::Jobs;
use device::Request;
use renders::RenderCache;

/// How long an idle worker sleeps before it looks at the queue unprompted.
const IDLE: Duration = Duration::from_secs(1);

/// Sizes of the worker's queue and caches.
#[derive(Debug, Clone, Copy)]
pub struct WorkerOptions {
    /// Renders that may wait; one more is turned away.
    pub render_queue: usize,
    /// Models kept ready.
    pub models: usize,
    /// Prepared lights kept ready.
    pub lights: usize,
}

impl Default for WorkerOptions {
    fn default() -> Self {
        Self { render_queue: 64, models: 4, lights: 32 }
    }
}

/// The device thread.
struct Worker {
    jobs: Jobs,
    renders: mpsc::Receiver<Request>,
    cache: RenderCache,
    changes: watch::Receiver<()>,
    stop: CancellationToken,
}

/// Starts the device thread. It ends, with its job checkpointed and released, after `stop` is cancelled.
///
/// Must be called inside a tokio runtime.
///
/// # Errors
/// When the operating system refuses a thread.
pub fn start(
    jobs: Jobs,
    options: WorkerOptions,
    stop: CancellationToken,
) -> std::io::Result<(Device, JoinHandle<()>)> {
    let (sender, renders) = mpsc::channel(options.render_queue);
    let changes = jobs.subscribe();
    let cache = RenderCache::new(options.models, options.lights);
    let worker = Worker { jobs, renders, cache, changes, stop };
    let runtime = tokio::runtime::Handle::current();
    let thread = std::thread::Builder::new()
        .name("relume-device".to_owned())
        .spawn(move || runtime.block_on(worker.run()))?;
    Ok((Device::new(sender), thread))
}

impl Worker {
    async fn run(mut self) {
        while !self.stop.is_cancelled() {
            self.changes.mark_unchanged();
            match self.jobs.claim().await {
                Ok(Some(lease)) => self.work(lease).await,
                Ok(None) => self.wait().await,
                Err(error) => {
                    tracing::error!(%error, "the queue cannot be read");
                    self.wait().await;
                }
            }
        }
    }

    /// Serves renders until something else may be due.
    async fn wait(&mut self) {
        tokio::select! {
            () = self.stop.cancelled() => {}
            request = self.renders.recv() => match request {
                Some(request) => self.serve(request),
                // Every handle is gone, and with it the server.
                None => self.stop.cancel(),
            },
            _ = self.changes.changed() => {}
            () = tokio::time::sleep(IDLE) => {}
        }
    }

    /// Renders what has been asked for meanwhile; a few at a time, so that training goes on under any load.
    fn serve_waiting(&mut self) {
        const BATCH: usize = 8;
        for _ in 0..BATCH {
            match self.renders.try_recv() {
                Ok(request) => self.serve(request),
                Err(_) => break,
            }
        }
    }

    fn serve(&mut self, request: Request) {
        let tier = request.task.tier;
        let frame = std::panic::catch_unwind(AssertUnwindSafe(|| self.cache.render(&request.task)));
        let frame = frame.unwrap_or_else(|panic| {
            self.cache.clear();
            Err(RenderFailure::Internal(panic_message(panic.as_ref())))
        });
        metrics::counter!("relume_renders_total", "tier" => format!("{tier:?}").to_lowercase(),
            "ok" => if frame.is_ok() { "true" } else { "false" })
        .increment(1);
        // The caller may have gone; its frame goes with it.
        let _ = request.reply.send(frame);
    }

    /// One attempt at a job, whatever happens in it.
    async fn work(&mut self, lease: crate::jobs::Lease) {
        let span = tracing::info_span!("job", id = lease.job().id, attempt = lease.job().attempts);
        tracing::info!(parent: &span, "started");
        let outcome = AssertUnwindSafe(self.train(&lease)).catch_unwind().await;
        let settled = match outcome {
            Ok(Ok(ending)) => {
                tracing::info!(parent: &span, ?ending, "ended");
                return;
            }
            Ok(Err(failure)) => {
                tracing::warn!(parent: &span, code = failure.code, detail = failure.detail, "failed");
                lease.fail(failure.code, &failure.detail).await
            }
            Err(panic) => {
                let detail = panic_message(panic.as_ref());
                tracing::error!(parent: &span, detail, "the attempt panicked");
                if lease.is_last_chance() {
                    lease.fail("attempts_exhausted", "every attempt ended in an internal error").await
                } else {
                    lease.release(false).await
                }
            }
        };
        if let Err(error) = settled {
            tracing::error!(parent: &span, %error, "the outcome could not be recorded; the lease will run out");
        }
    }
}

/// What a panic said, as far as it said it in words.
fn panic_message(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "panic".to_owned())
}
