//! Starts the threads of a worker.

use std::io;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::thread::JoinHandle;

use tokio_util::sync::CancellationToken;

use crate::worker::device_handle::DeviceHandle;
use crate::worker::frame_server::FrameServer;
use crate::worker::frame_thread;
use crate::worker::job_source::JobSource;
use crate::worker::opened_device::OpenedDevice;
use crate::worker::previews::Previews;
use crate::worker::render_queue::render_queue;
use crate::worker::renders::RenderCache;
use crate::worker::thread::{JobOutcome, Worker};
use relume_capture::ImportLimits;
use relume_engine::DeviceChoice;

/// Options of a worker.
#[derive(Debug, Clone, Copy)]
pub struct WorkerOptions {
    /// Maximum number of queued renders; further renders are refused.
    pub render_queue: usize,
    /// Maximum number of cached models, at least 1.
    pub models: usize,
    /// Maximum number of cached prepared lights, at least 1.
    pub lights: usize,
    /// The device for training and rendering.
    pub device: DeviceChoice,
    /// Limits of captures, for uploads and for jobs.
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

/// Starts a training thread and rendering threads on `device`. A frame waits for a training at most as long as the device is busy
/// with it. After `stop` is cancelled, the job is checkpointed and released, and the threads exit.
///
/// Must be called inside a tokio runtime.
///
/// # Errors
/// When the operating system refuses a thread.
pub fn start(
    source: Arc<dyn JobSource>,
    device: OpenedDevice,
    options: WorkerOptions,
    stop: CancellationToken,
) -> io::Result<(DeviceHandle, JoinHandle<()>)> {
    let has_gpu = device.device().is_gpu();
    let (queue, waiting) = render_queue(options.render_queue);
    let last = stop.child_token();
    let steps = Arc::new(AtomicU64::new(0));
    let cache = RenderCache::new(options.models, options.lights);
    let training_device = device.shared();
    let frames = FrameServer::new(device, waiting, cache, steps.clone());
    let ended = CancellationToken::new();
    let frame_threads = frame_thread::start(frames, ended.clone())?;
    let previews = Arc::new(Previews::default());
    let (changes, abandoned) = (source.changes(), last.clone());
    let worker = Worker {
        source,
        device: training_device,
        steps: steps.clone(),
        previews: previews.clone(),
        import_limits: options.import_limits,
        changes,
        stop,
        abandoned,
        once: false,
    };
    let runtime = tokio::runtime::Handle::current();
    let ended = ended.drop_guard();
    let work = move || {
        runtime.block_on(worker.run());
        drop(ended);
        for thread in frame_threads {
            if thread.join().is_err() {
                tracing::error!("a rendering thread panicked");
            }
        }
    };
    let thread = std::thread::Builder::new().name("relume-training".to_owned()).spawn(work)?;
    Ok((DeviceHandle::new(queue, steps, has_gpu, previews, last.drop_guard()), thread))
}

/// Options of a worker that renders no frames.
#[derive(Debug, Clone, Copy, Default)]
pub struct TrainingOptions {
    /// Limits of captures.
    pub import_limits: ImportLimits,
    /// Whether the worker exits after one job, or if no job is queued.
    pub once: bool,
}

/// Starts a training thread without rendering threads. After `stop` is cancelled, the job is checkpointed and released, and the
/// thread returns the result of its last job.
///
/// Must be called inside a tokio runtime.
///
/// # Errors
/// When the operating system refuses a thread.
pub fn start_training(
    source: Arc<dyn JobSource>,
    device: OpenedDevice,
    options: TrainingOptions,
    stop: CancellationToken,
) -> io::Result<JoinHandle<Option<JobOutcome>>> {
    let changes = source.changes();
    let worker = Worker {
        source,
        device,
        steps: Arc::default(),
        previews: Arc::default(),
        import_limits: options.import_limits,
        changes,
        stop,
        abandoned: CancellationToken::new(),
        once: options.once,
    };
    let runtime = tokio::runtime::Handle::current();
    let work = move || runtime.block_on(worker.run());
    std::thread::Builder::new().name("relume-training".to_owned()).spawn(work)
}
