//! A frame that was asked for, on its way to the device thread and back.

use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use crate::render::Frame;
use crate::worker::renders::{RenderFailure, RenderTask};

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

/// Where the frame of a task arrives; it fails when nobody renders it.
type Reply = oneshot::Receiver<Result<Rendered, RenderFailure>>;

impl QueuedRender {
    /// A task that is queued now, and where its frame arrives.
    pub(super) fn new(task: RenderTask, steps_at_start: u64) -> (Self, Reply) {
        let (reply, frame) = oneshot::channel();
        (Self { task, reply, queued: Instant::now(), steps_at_start }, frame)
    }

    /// Answers with what `render` makes of the task. It is told whether the caller still waits, so that it can stop.
    pub(super) fn answer(
        self,
        steps_now: u64,
        render: impl FnOnce(&RenderTask, &dyn Fn() -> bool) -> Result<Frame, RenderFailure>,
    ) {
        let waited = self.queued.elapsed();
        let begin = Instant::now();
        let steps_waited = steps_now - self.steps_at_start;
        let rendered = render(&self.task, &|| !self.reply.is_closed());
        let rendered = rendered.map(|frame| Rendered { frame, waited, steps_waited, took: begin.elapsed() });
        let _ = self.reply.send(rendered);
    }
}
