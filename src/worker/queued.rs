//! What was asked for, on its way to the thread of frames and back.

use std::time::{Duration, Instant};

use tokio::sync::oneshot;
use tracing::Span;

use crate::worker::renders::{LightTask, RenderFailure, RenderTask};
use relume_spec::rendering::Quality;
use relume_train::render::Frame;

/// An answer and what it cost to get it.
#[derive(Debug, Clone)]
pub struct TimedAnswer<T> {
    /// What was asked for.
    pub answer: T,
    /// Time in the queue.
    pub waited: Duration,
    /// Training steps that ended meanwhile.
    pub steps_waited: u64,
    /// Time on the device, preparation of model and light included.
    pub took: Duration,
}

/// A task and where its answer goes.
pub(super) struct Queued<Task, Answer> {
    pub(super) task: Task,
    reply: oneshot::Sender<Result<TimedAnswer<Answer>, RenderFailure>>,
    queued: Instant,
    /// Training steps done when it was queued.
    steps_at_start: u64,
    /// What asked for it: what is done for the task belongs there, on whichever thread.
    span: Span,
    /// The time in the queue.
    wait: Span,
}

/// Where the answer to a task arrives; it fails when nobody serves it.
type Reply<Answer> = oneshot::Receiver<Result<TimedAnswer<Answer>, RenderFailure>>;

impl<Task, Answer> Queued<Task, Answer> {
    /// A task that is queued now, and where its answer arrives.
    pub(super) fn new(task: Task, steps_at_start: u64) -> (Self, Reply<Answer>) {
        let (reply, answer) = oneshot::channel();
        let span = Span::current();
        let wait = if span.is_disabled() { Span::none() } else { tracing::info_span!(parent: &span, "wait") };
        (Self { task, reply, queued: Instant::now(), steps_at_start, span, wait }, answer)
    }

    /// Answers with what `serve` makes of the task. It is told whether the caller still waits, so that it can stop.
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

/// What the thread of frames is asked for.
pub(super) enum Request {
    /// A frame.
    Frame(Queued<RenderTask, Frame>),
    /// The stream of a light.
    Light(Queued<LightTask, Vec<u8>>),
}

impl Request {
    /// What it costs on the device beside others, as [`RenderTask::cost`]. A light may have to be prepared, which nothing
    /// interrupts: it does not come between the bands of a frame.
    pub(super) fn cost(&self) -> u64 {
        match self {
            Self::Frame(frame) => frame.task.cost(),
            Self::Light(_) => Quality::BAND_COST + 1,
        }
    }
}
