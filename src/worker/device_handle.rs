//! The handle with which the service sends work to the threads of its worker.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio_util::sync::DropGuard;

use crate::worker::previews::{Preview, Previews};
use crate::worker::queued::{Queued, Request, TimedAnswer};
use crate::worker::render_queue::{RenderPriority, RenderQueue};
use crate::worker::renders::{LightTask, RenderFailure, RenderTask};
use relume_api::JobId;
use relume_train::render::Frame;

/// Timeout of a render, including its time in the queue: sufficient for the first preparation of a light.
const RENDER_TIMEOUT: Duration = Duration::from_secs(120);

/// Sends render tasks to the device. Cheap to clone.
#[derive(Clone)]
pub struct DeviceHandle {
    requests: RenderQueue,
    /// Completed training steps.
    steps: Arc<AtomicU64>,
    has_gpu: bool,
    previews: Arc<Previews>,
    /// Stops the threads when the last handle is dropped.
    _last: Arc<DropGuard>,
}

impl DeviceHandle {
    pub(super) fn new(
        requests: RenderQueue,
        steps: Arc<AtomicU64>,
        has_gpu: bool,
        previews: Arc<Previews>,
        last: DropGuard,
    ) -> Self {
        Self { requests, steps, has_gpu, previews, _last: Arc::new(last) }
    }

    /// The last preview of a job's training, if it runs. A request enables previews every few seconds for a minute, so the first
    /// request returns `None`.
    pub fn preview(&self, job: &JobId) -> Option<Preview> {
        self.previews.latest(job)
    }

    /// Renders a frame. If the caller drops the future, rendering does not start, or stops early.
    ///
    /// # Errors
    /// [`RenderFailure::Busy`] if the queue is full; otherwise the error of the renderer.
    pub async fn render(&self, task: RenderTask) -> Result<TimedAnswer<Frame>, RenderFailure> {
        self.ask(task, RenderPriority::Interactive, Request::frame).await
    }

    /// Renders a frame with the lowest priority, when no other frame is queued.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub async fn render_in_background(&self, task: RenderTask) -> Result<TimedAnswer<Frame>, RenderFailure> {
        self.ask(task, RenderPriority::Background, Request::frame).await
    }

    /// Makes the stream of a light, between frames. If the caller drops the future, the light is not prepared.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub async fn light(&self, task: LightTask) -> Result<TimedAnswer<Vec<u8>>, RenderFailure> {
        self.ask(task, RenderPriority::Interactive, Request::light).await
    }

    async fn ask<Task, Answer>(
        &self,
        task: Task,
        priority: RenderPriority,
        request: impl FnOnce(Queued<Task, Answer>) -> Request,
    ) -> Result<TimedAnswer<Answer>, RenderFailure> {
        let (queued, answer) = Queued::new(task, self.steps.load(Ordering::SeqCst));
        let _slot = self.requests.push(request(queued), priority).ok_or(RenderFailure::Busy)?;
        match tokio::time::timeout(RENDER_TIMEOUT, answer).await {
            Ok(Ok(result)) => result,
            Ok(Err(_)) | Err(_) => Err(RenderFailure::Busy),
        }
    }

    /// Whether the server was started on a GPU.
    pub fn has_gpu(&self) -> bool {
        self.has_gpu
    }

    /// Whether the rendering thread runs.
    pub fn is_alive(&self) -> bool {
        !self.requests.is_closed()
    }
}
