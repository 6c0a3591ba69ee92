//! The handle by which the rest of the service reaches the device thread.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use tokio::sync::{mpsc, oneshot};

use crate::render::Frame;
use crate::worker::renders::{RenderFailure, RenderTask};

/// How long a render may wait for the device and run: long enough for a training step and the first preparation of a light.
const RENDER_TIMEOUT: Duration = Duration::from_secs(120);

/// A frame and what it cost to get it.
#[derive(Debug, Clone)]
pub struct Rendered {
    /// The frame.
    pub frame: Frame,
    /// Time in the queue.
    pub waited: Duration,
    /// Training steps that ended meanwhile.
    pub steps_waited: u64,
    /// Time on the device, preparation of model and light included.
    pub took: Duration,
}

/// A task and where its frame goes.
pub(super) struct QueuedRender {
    pub(super) task: RenderTask,
    pub(super) reply: oneshot::Sender<Result<Rendered, RenderFailure>>,
    queued: Instant,
    /// Training steps done when it was queued.
    steps_at_start: u64,
}

impl QueuedRender {
    /// Answers with what `render` makes of the task. The frame is dropped when the caller does not wait any more.
    pub(super) fn answer(
        self,
        steps_now: u64,
        render: impl FnOnce(&RenderTask) -> Result<Frame, RenderFailure>,
    ) {
        let waited = self.queued.elapsed();
        let begin = Instant::now();
        let steps_waited = steps_now - self.steps_at_start;
        let rendered =
            render(&self.task).map(|frame| Rendered { frame, waited, steps_waited, took: begin.elapsed() });
        let _ = self.reply.send(rendered);
    }
}

/// Asks the device thread for frames. Cheap to clone.
#[derive(Clone)]
pub struct DeviceHandle {
    requests: mpsc::Sender<QueuedRender>,
    /// Training steps the device thread has done.
    steps: Arc<AtomicU64>,
    has_gpu: bool,
}

impl DeviceHandle {
    pub(super) fn new(requests: mpsc::Sender<QueuedRender>, steps: Arc<AtomicU64>, has_gpu: bool) -> Self {
        Self { requests, steps, has_gpu }
    }

    /// Renders between training steps.
    ///
    /// # Errors
    /// [`RenderFailure::Busy`] when too many wait already, otherwise what the renderer said.
    pub async fn render(&self, task: RenderTask) -> Result<Rendered, RenderFailure> {
        let (reply, frame) = oneshot::channel();
        let steps_at_start = self.steps.load(Ordering::SeqCst);
        let request = QueuedRender { task, reply, queued: Instant::now(), steps_at_start };
        self.requests.try_send(request).map_err(|_| RenderFailure::Busy)?;
        match tokio::time::timeout(RENDER_TIMEOUT, frame).await {
            Ok(Ok(result)) => result,
            Ok(Err(_)) | Err(_) => Err(RenderFailure::Busy),
        }
    }

    /// True when the server was started on a GPU.
    pub fn has_gpu(&self) -> bool {
        self.has_gpu
    }

    /// True while the device thread lives.
    pub fn is_alive(&self) -> bool {
        !self.requests.is_closed()
    }
}
