//! The handle by which the rest of the service reaches the threads of its worker.

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

/// How long a render may wait for its turn and run: long enough for the first preparation of a light.
const RENDER_TIMEOUT: Duration = Duration::from_secs(120);

/// Asks for frames. Cheap to clone.
#[derive(Clone)]
pub struct DeviceHandle {
    requests: RenderQueue,
    /// Training steps done.
    steps: Arc<AtomicU64>,
    has_gpu: bool,
    previews: Arc<Previews>,
    /// Ends the threads when the last handle is dropped.
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

    /// How the training of a job looked when it was last looked at, if it runs. It is looked at every few seconds for a minute
    /// after somebody asked, so that the first answer is nothing.
    pub fn preview(&self, job: &JobId) -> Option<Preview> {
        self.previews.latest(job)
    }

    /// Renders. When the result is not waited for any more, nothing is rendered, or no more of it.
    ///
    /// # Errors
    /// [`RenderFailure::Busy`] when too many wait already, otherwise what the renderer said.
    pub async fn render(&self, task: RenderTask) -> Result<TimedAnswer<Frame>, RenderFailure> {
        self.ask(task, RenderPriority::Interactive, Request::Frame).await
    }

    /// Renders while nobody else waits for a frame.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub async fn render_in_background(&self, task: RenderTask) -> Result<TimedAnswer<Frame>, RenderFailure> {
        self.ask(task, RenderPriority::Background, Request::Frame).await
    }

    /// The stream of a light, made between frames. When it is not waited for any more, nothing is prepared.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub async fn light(&self, task: LightTask) -> Result<TimedAnswer<Vec<u8>>, RenderFailure> {
        self.ask(task, RenderPriority::Interactive, Request::Light).await
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

    /// True when the server was started on a GPU.
    pub fn has_gpu(&self) -> bool {
        self.has_gpu
    }

    /// True while the thread that renders lives.
    pub fn is_alive(&self) -> bool {
        !self.requests.is_closed()
    }
}
