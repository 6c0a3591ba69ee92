//! Renders the queued frames on one device, on a rendering thread.

use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::worker::opened_device::OpenedDevice;
use crate::worker::panics::panic_message;
use crate::worker::queued::Request;
use crate::worker::render_queue::RenderReceiver;
use crate::worker::renders::{LightTask, RenderCache, RenderFailure, RenderTask};
use relume_train::render::Frame;

/// Maximum number of frames served at a time, and between two bands of an expensive frame.
const BATCH: usize = 8;

/// A device with its queue of frames, and the cached models and lights.
pub(super) struct FrameServer {
    device: OpenedDevice,
    waiting: RenderReceiver,
    /// The cache is shared with the other rendering threads of the device.
    cache: Arc<RenderCache>,
    /// Completed training steps.
    steps: Arc<AtomicU64>,
}

impl FrameServer {
    pub(super) fn new(
        device: OpenedDevice,
        waiting: RenderReceiver,
        cache: RenderCache,
        steps: Arc<AtomicU64>,
    ) -> Self {
        Self { device, waiting, cache: Arc::new(cache), steps }
    }

    /// Whether frames are rendered by a GPU.
    pub(super) fn is_on_gpu(&self) -> bool {
        self.device.device().is_gpu()
    }

    /// Another server for the same queue, device and cache.
    pub(super) fn shared(&self) -> Self {
        let (waiting, cache, steps) = (self.waiting.clone(), self.cache.clone(), self.steps.clone());
        Self { device: self.device.shared(), waiting, cache, steps }
    }

    /// Waits until a frame is queued or another thread has replaced the device.
    pub(super) async fn arrival(&mut self) {
        tokio::select! {
            () = self.waiting.arrival() => {}
            () = self.device.device_replaced() => {}
        }
    }

    /// Serves the queued frames, a few at a time. Clears the cache if another thread has replaced the device, because the old
    /// device may be lost or its memory may be needed.
    pub(super) fn serve_waiting(&mut self) {
        if self.device.renew() {
            self.cache.clear();
        }
        for _ in 0..BATCH {
            match self.waiting.try_recv() {
                Some(request) => self.serve(request),
                None => break,
            }
        }
    }

    /// Opens the device again after a failure, because a failed device cannot be used. If this fails, the CPU engine replaces it.
    fn reopen(&mut self) {
        self.cache.clear();
        self.device.reopen();
    }

    fn serve(&mut self, request: Request) {
        let steps = self.steps.load(Ordering::SeqCst);
        match request {
            Request::Frame(request) => request.answer(steps, |task, is_wanted| {
                let frame = self.guarded(|this| this.render(task, is_wanted));
                metrics::counter!("relume_renders_total", "tier" => task.quality.tier.name(),
                    "ok" => if frame.is_ok() { "true" } else { "false" })
                .increment(1);
                frame
            }),
            Request::Light(request) => {
                request.answer(steps, |task, is_wanted| self.guarded(|this| this.light(task, is_wanted)))
            }
        }
    }

    /// Serves a request, handles a panic, and reopens a failed device.
    fn guarded<T>(
        &mut self,
        serve: impl FnOnce(&mut Self) -> Result<T, RenderFailure>,
    ) -> Result<T, RenderFailure> {
        let answer = std::panic::catch_unwind(AssertUnwindSafe(|| serve(self)));
        let answer = answer.unwrap_or_else(|panic| {
            self.cache.clear();
            Err(RenderFailure::Internal(panic_message(panic.as_ref())))
        });
        if matches!(answer, Err(RenderFailure::Device(_))) {
            self.reopen();
        }
        answer
    }

    fn light(&mut self, task: &LightTask, is_wanted: &dyn Fn() -> bool) -> Result<Vec<u8>, RenderFailure> {
        let lit = self.cache.lit_model(task, self.device.device(), is_wanted)?;
        Ok(lit.stream(task.with_map))
    }

    /// Renders a task. Between the bands of an expensive frame it renders queued frames of a single band.
    fn render(&mut self, task: &RenderTask, is_wanted: &dyn Fn() -> bool) -> Result<Frame, RenderFailure> {
        let scene = self.cache.scene(task, self.device.device(), is_wanted)?;
        scene.render(task, || {
            for _ in 0..BATCH {
                match self.waiting.try_recv_cheap() {
                    Some(request) => self.serve(request),
                    None => break,
                }
            }
            if is_wanted() { Ok(()) } else { Err(RenderFailure::Abandoned) }
        })
    }
}
