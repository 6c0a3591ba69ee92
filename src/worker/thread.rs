//! The device thread: takes jobs from the queue and renders what is asked for meanwhile.

use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use futures::FutureExt;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::engine::Device;
use crate::engine::{DeviceChoice, DeviceError};
use crate::jobs::{Jobs, Lease};
use crate::render::Frame;
use crate::store::StoreError;
use crate::worker::device_handle::DeviceHandle;
use crate::worker::queued_render::QueuedRender;
use crate::worker::render_queue::{WaitingRenders, render_queue};
use crate::worker::renders::{RenderCache, RenderFailure, RenderTask};

/// How long an idle worker sleeps before it looks at the queue unprompted.
const IDLE: Duration = Duration::from_secs(1);
/// Most frames that come before what they interrupt goes on.
const BATCH: usize = 8;

/// Sizes of the worker's queue and caches.
#[derive(Debug, Clone, Copy)]
pub struct WorkerOptions {
    /// Renders that may wait; one more is turned away.
    pub render_queue: usize,
    /// Models in the cache, at least 1.
    pub models: usize,
    /// Prepared lights in the cache, at least 1.
    pub lights: usize,
    /// Where to train and render.
    pub device: DeviceChoice,
}

impl Default for WorkerOptions {
    fn default() -> Self {
        Self { render_queue: 64, models: 4, lights: 32, device: DeviceChoice::Auto }
    }
}

/// Why the device thread did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The device that was asked for cannot be had.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The operating system refused a thread.
    #[error(transparent)]
    Thread(#[from] std::io::Error),
}

/// The device thread.
pub(super) struct Worker {
    pub(super) jobs: Jobs,
    choice: DeviceChoice,
    pub(super) device: Device,
    pub(super) renders: WaitingRenders,
    cache: RenderCache,
    /// Training steps done.
    pub(super) steps: Arc<AtomicU64>,
    pub(super) changes: watch::Receiver<()>,
    pub(super) stop: CancellationToken,
    /// Cancelled when nobody can ask for frames any more: the server has ended.
    abandoned: CancellationToken,
}

/// Starts the device thread. It ends, with its job checkpointed and released, after `stop` is cancelled.
///
/// Must be called inside a tokio runtime.
///
/// # Errors
/// When the device cannot be had or the operating system refuses a thread.
pub fn start(
    jobs: Jobs,
    options: WorkerOptions,
    stop: CancellationToken,
) -> Result<(DeviceHandle, JoinHandle<()>), StartError> {
    let device = Device::open(options.device)?;
    tracing::info!(device = device.name(), "device ready");
    let has_gpu = device.is_gpu();
    let (queue, renders) = render_queue(options.render_queue);
    let last = stop.child_token();
    let abandoned = last.clone();
    let changes = jobs.subscribe();
    let cache = RenderCache::new(options.models, options.lights);
    let steps = Arc::new(AtomicU64::new(0));
    let worker = Worker {
        jobs,
        choice: options.device,
        device,
        renders,
        cache,
        steps: steps.clone(),
        changes,
        stop,
        abandoned,
    };
    let runtime = tokio::runtime::Handle::current();
    let thread = std::thread::Builder::new()
        .name("relume-device".to_owned())
        .spawn(move || runtime.block_on(worker.run()))?;
    Ok((DeviceHandle::new(queue, steps, has_gpu, last.drop_guard()), thread))
}

impl Worker {
    async fn run(mut self) {
        while !self.stop.is_cancelled() {
            self.changes.mark_unchanged();
            if self.lacks_room().await {
                self.wait().await;
                continue;
            }
            match self.jobs.claim().await {
                Ok(Some(lease)) => self.work(lease).await,
                Ok(None) => self.wait().await,
                Err(error) => {
                    tracing::error!(%error, "no job can be claimed");
                    if matches!(error, StoreError::Full) {
                        self.jobs.store().room().note_shortage(1);
                    }
                    self.wait().await;
                }
            }
        }
    }

    /// Serves renders until something else may be due.
    pub(super) async fn wait(&mut self) {
        tokio::select! {
            () = self.stop.cancelled() => {}
            () = self.abandoned.cancelled() => self.stop.cancel(),
            request = self.renders.recv() => self.serve(request),
            _ = self.changes.changed() => {}
            () = tokio::time::sleep(IDLE) => {}
        }
    }

    /// Renders what was asked for meanwhile; a few frames at a time, so that training continues under any load.
    pub(super) fn serve_waiting(&mut self) {
        for _ in 0..BATCH {
            match self.renders.try_recv() {
                Some(request) => self.serve(request),
                None => break,
            }
        }
    }

    pub(super) fn serve(&mut self, request: QueuedRender) {
        let steps = self.steps.load(Ordering::SeqCst);
        request.answer(steps, |task, is_wanted| {
            let frame = std::panic::catch_unwind(AssertUnwindSafe(|| self.render(task, is_wanted)));
            let frame = frame.unwrap_or_else(|panic| {
                self.cache.clear();
                Err(RenderFailure::Internal(panic_message(panic.as_ref())))
            });
            if matches!(frame, Err(RenderFailure::Device(_))) {
                self.reopen();
            }
            metrics::counter!("relume_renders_total", "tier" => task.quality.tier.name(),
                "ok" => if frame.is_ok() { "true" } else { "false" })
            .increment(1);
            frame
        });
    }

    /// Renders a task, and between the bands of a dear one those that wait and have a single band.
    fn render(&mut self, task: &RenderTask, is_wanted: &dyn Fn() -> bool) -> Result<Frame, RenderFailure> {
        let scene = self.cache.scene(task, &self.device, is_wanted)?;
        scene.render(task, || {
            for _ in 0..BATCH {
                match self.renders.try_recv_cheap() {
                    Some(request) => self.serve(request),
                    None => break,
                }
            }
            if is_wanted() { Ok(()) } else { Err(RenderFailure::Abandoned) }
        })
    }

    /// Opens the device again after it failed; nothing on a failed device can be used. If it cannot be opened, the CPU
    /// engine replaces it.
    fn reopen(&mut self) {
        self.cache.clear();
        self.device = Device::open(self.choice).unwrap_or_else(|error| {
            tracing::error!(%error, "the device cannot be opened again; the CPU engine takes over");
            Device::Cpu
        });
        tracing::warn!(device = self.device.name(), "device opened again");
    }

    /// Makes one attempt at a job and records how it ended, also when it panics.
    async fn work(&mut self, lease: Lease) {
        let span = tracing::info_span!("job", id = %lease.job().id, attempt = lease.job().attempts);
        tracing::info!(parent: &span, "started");
        let outcome = AssertUnwindSafe(self.train(&lease)).catch_unwind().await;
        match outcome {
            Ok(Ok(ending)) => {
                tracing::info!(parent: &span, ?ending, "ended");
            }
            Ok(Err(failure)) => {
                tracing::warn!(parent: &span, code = failure.code, detail = failure.detail, "failed");
                if failure.is_device_failure() {
                    self.reopen();
                }
                self.record_failure(&lease, failure).await;
            }
            Err(panic) => {
                let detail = panic_message(panic.as_ref());
                tracing::error!(parent: &span, detail, "the attempt panicked");
                self.record_panic(&lease).await;
            }
        }
    }
}

/// The message of a panic.
fn panic_message(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "panic".to_owned())
}
