//! The device thread: takes jobs from the queue, and renders on a GPU what is asked for meanwhile.

use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::thread::JoinHandle;
use std::time::Duration;

use futures::FutureExt;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::capture::ImportLimits;
use crate::engine::{Device, DeviceChoice, DeviceError};
use crate::jobs::{Jobs, Lease};
use crate::store::StoreError;
use crate::worker::device_handle::DeviceHandle;
use crate::worker::frame_server::FrameServer;
use crate::worker::frame_thread;
use crate::worker::panics::panic_message;
use crate::worker::previews::Previews;
use crate::worker::render_queue::render_queue;
use crate::worker::renders::RenderCache;

/// How long an idle worker sleeps before it looks at the queue unprompted.
const IDLE: Duration = Duration::from_secs(1);

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
    /// Bounds on captures, when they are uploaded and when a job reads them.
    pub import_limits: ImportLimits,
}

impl Default for WorkerOptions {
    fn default() -> Self {
        Self {
            render_queue: 64,
            models: 4,
            lights: 32,
            device: DeviceChoice::Auto,
            import_limits: ImportLimits::default(),
        }
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
    /// The GPU and the frames that are served between what else it does. `None` without one: frames of the CPU engine have a
    /// thread of their own.
    pub(super) frames: Option<FrameServer>,
    /// Training steps done.
    pub(super) steps: Arc<AtomicU64>,
    /// How what trains looks.
    pub(super) previews: Arc<Previews>,
    /// Bounds on captures.
    pub(super) import_limits: ImportLimits,
    pub(super) changes: watch::Receiver<()>,
    pub(super) stop: CancellationToken,
    /// Cancelled when nobody can ask for frames any more: the server has ended.
    pub(super) abandoned: CancellationToken,
}

/// Starts the device thread, and one for frames when they are rendered on the CPU. They end, with the job checkpointed and
/// released, after `stop` is cancelled.
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
    let (queue, waiting) = render_queue(options.render_queue);
    let last = stop.child_token();
    let steps = Arc::new(AtomicU64::new(0));
    let cache = RenderCache::new(options.models, options.lights);
    let frames = FrameServer::new((options.device, device), waiting, cache, steps.clone());
    let ended = CancellationToken::new();
    let (frames, frame_thread) = if has_gpu {
        (Some(frames), None)
    } else {
        (None, Some(frame_thread::start(frames, ended.clone())?))
    };
    let previews = Arc::new(Previews::default());
    let (changes, abandoned) = (jobs.subscribe(), last.clone());
    let worker = Worker {
        jobs,
        frames,
        steps: steps.clone(),
        previews: previews.clone(),
        import_limits: options.import_limits,
        changes,
        stop,
        abandoned,
    };
    let runtime = tokio::runtime::Handle::current();
    let ended = ended.drop_guard();
    let work = move || {
        runtime.block_on(worker.run());
        drop(ended);
        if frame_thread.is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("the frame thread did not end well");
        }
    };
    let thread = std::thread::Builder::new().name("relume-device".to_owned()).spawn(work)?;
    Ok((DeviceHandle::new(queue, steps, has_gpu, previews, last.drop_guard()), thread))
}

/// Serves what waits for the GPU, once something does; never ends without one.
pub(super) async fn serve_next(frames: &mut Option<FrameServer>) {
    match frames {
        Some(frames) => {
            frames.arrival().await;
            frames.serve_waiting();
        }
        None => std::future::pending().await,
    }
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
            () = serve_next(&mut self.frames) => {}
            _ = self.changes.changed() => {}
            () = tokio::time::sleep(IDLE) => {}
        }
    }

    /// Renders what the GPU was asked for meanwhile.
    pub(super) fn serve_waiting(&mut self) {
        if let Some(frames) = &mut self.frames {
            frames.serve_waiting();
        }
    }

    /// What trains where a job does not say.
    pub(super) fn device(&self) -> &Device {
        self.frames.as_ref().map_or(&Device::Cpu, FrameServer::device)
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
                if let (true, Some(frames)) = (failure.is_device_failure(), &mut self.frames) {
                    frames.reopen();
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
