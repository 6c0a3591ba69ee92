//! The door to the device thread for everyone else.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use tokio::sync::{mpsc, oneshot};

use crate::render::{Frame, RenderError};
use crate::worker::RenderTask;

/// How long a render may wait for the device and run. A training step and a first light preparation fit in.
const PATIENCE: Duration = Duration::from_secs(120);

/// Why there is no frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RenderFailure {
    /// The queue is full or the device did not come round to it in time.
    #[error("the device is busy")]
    Busy,
    /// The request cannot be rendered.
    #[error("{field}: {reason}")]
    Refused {
        /// The request field at fault.
        field: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// The device failed; the request may be made again.
    #[error(transparent)]
    Device(#[from] crate::engine::gpu::GpuError),
    /// Our fault; the text is for the log.
    #[error("{0}")]
    Internal(String),
}

impl From<RenderError> for RenderFailure {
    fn from(error: RenderError) -> Self {
        match error {
            RenderError::Refused { field, reason } => Self::Refused { field, reason },
            RenderError::Device(error) => Self::Device(error),
        }
    }
}

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

/// A task and whom to tell.
pub(super) struct Request {
    pub(super) task: RenderTask,
    pub(super) reply: oneshot::Sender<Result<Rendered, RenderFailure>>,
    queued: Instant,
    /// Training steps done when it was queued.
    steps_then: u64,
}

impl Request {
    /// Answers with what `render` makes of the task; the caller may have gone, and its frame goes with it.
    pub(super) fn answer(
        self,
        steps_now: u64,
        render: impl FnOnce(&RenderTask) -> Result<Frame, RenderFailure>,
    ) {
        let waited = self.queued.elapsed();
        let begin = Instant::now();
        let steps_waited = steps_now - self.steps_then;
        let rendered =
            render(&self.task).map(|frame| Rendered { frame, waited, steps_waited, took: begin.elapsed() });
        let _ = self.reply.send(rendered);
    }
}

/// Asks the device thread for frames. Cheap to clone.
#[derive(Clone)]
pub struct Device {
    requests: mpsc::Sender<Request>,
    /// Training steps the device thread has done.
    steps: Arc<AtomicU64>,
    has_gpu: bool,
}

impl Device {
    pub(super) fn new(requests: mpsc::Sender<Request>, steps: Arc<AtomicU64>, has_gpu: bool) -> Self {
        Self { requests, steps, has_gpu }
    }

    /// Renders between training steps.
    ///
    /// # Errors
    /// [`RenderFailure::Busy`] when too many wait already, otherwise what the renderer said.
    pub async fn render(&self, task: RenderTask) -> Result<Rendered, RenderFailure> {
        let (reply, frame) = oneshot::channel();
        let steps_then = self.steps.load(Ordering::SeqCst);
        let request = Request { task, reply, queued: Instant::now(), steps_then };
        self.requests.try_send(request).map_err(|_| RenderFailure::Busy)?;
        match tokio::time::timeout(PATIENCE, frame).await {
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
