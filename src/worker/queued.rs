//! Requests on their way to a rendering thread, and their answers.

use std::time::{Duration, Instant};

use tokio::sync::oneshot;
use tracing::Span;

use crate::worker::renders::{LightTask, RenderFailure, RenderTask};
use relume_spec::rendering::Quality;
use relume_train::render::Frame;

/// An answer with its timing.
#[derive(Debug, Clone)]
pub struct TimedAnswer<T> {
    /// The result.
    pub answer: T,
    /// Time in the queue.
    pub waited: Duration,
    /// Training steps that ended in the meantime.
    pub steps_waited: u64,
    /// Time on the device, including preparation of model and light.
    pub took: Duration,
}

/// A task with the destination of its answer.
pub(super) struct Queued<Task, Answer> {
    pub(super) task: Task,
    reply: oneshot::Sender<Result<TimedAnswer<Answer>, RenderFailure>>,
    queued: Instant,
    /// Completed training steps at the time of the request.
    steps_at_start: u64,
    /// The span of the caller. Work for the task is recorded in it, on any thread.
    span: Span,
    /// The span of the time in the queue.
    wait: Span,
}

/// Receives the answer to a task. It fails if the task is dropped.
type Reply<Answer> = oneshot::Receiver<Result<TimedAnswer<Answer>, RenderFailure>>;

impl<Task, Answer> Queued<Task, Answer> {
    /// Queues a task. Returns it with the receiver of its answer.
    pub(super) fn new(task: Task, steps_at_start: u64) -> (Self, Reply<Answer>) {
        let (reply, answer) = oneshot::channel();
        let span = Span::current();
        let wait = if span.is_disabled() { Span::none() } else { tracing::info_span!(parent: &span, "wait") };
        (Self { task, reply, queued: Instant::now(), steps_at_start, span, wait }, answer)
    }

    /// Sends the result of `serve` as the answer. `serve` can query whether the caller still waits, so that it can stop.
    pub(super) fn answer(
        self,
        steps_now: u64,
        serve: impl FnOnce(&Task, &dyn Fn() -> bool) -> Result<Answer, RenderFailure>,
    ) {
        drop(self.wait);
        let waited = self.queued.elapsed();
        let begin = Instant::now();
        let steps_waited = steps_now - self.steps_at_start;
        let answer = self.span.in_scope(|| serve(&self.task, &|| !self.reply.is_closed()));
        let served = answer.map(|answer| TimedAnswer { answer, waited, steps_waited, took: begin.elapsed() });
        let _ = self.reply.send(served);
    }
}

/// A request to a rendering thread.
pub(super) enum Request {
    /// A frame.
    Frame(Box<Queued<RenderTask, Frame>>),
    /// The stream of a light.
    Light(Box<Queued<LightTask, Vec<u8>>>),
}

impl Request {
    /// A request for a frame.
    pub(super) fn frame(queued: Queued<RenderTask, Frame>) -> Self {
        Self::Frame(Box::new(queued))
    }

    /// A request for the stream of a light.
    pub(super) fn light(queued: Queued<LightTask, Vec<u8>>) -> Self {
        Self::Light(Box::new(queued))
    }

    /// The relative cost on the device, as [`RenderTask::cost`]. The preparation of a light cannot be interrupted, so a light is
    /// not served between the bands of a frame.
    pub(super) fn cost(&self) -> u64 {
        match self {
            Self::Frame(frame) => frame.task.cost(),
            Self::Light(_) => Quality::BAND_COST + 1,
        }
    }
}
