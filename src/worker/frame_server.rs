//! Rendering what waits in the queue, on one device, on the thread of frames.

use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::worker::opened_device::OpenedDevice;
use crate::worker::panics::panic_message;
use crate::worker::queued::Request;
use crate::worker::render_queue::RenderReceiver;
use crate::worker::renders::{LightTask, RenderCache, RenderFailure, RenderTask};
use relume_train::render::Frame;

/// Most frames that come at once; and between two bands of a dear one.
const BATCH: usize = 8;

/// A device with the frames that wait for it, and the models and lights they use.
pub(super) struct FrameServer {
    device: OpenedDevice,
    waiting: RenderReceiver,
    /// Shared with other threads of frames on the device.
    cache: Arc<RenderCache>,
    /// Training steps done.
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

    /// Another one for the same queue, device and cache.
    pub(super) fn shared(&self) -> Self {
        let (waiting, cache, steps) = (self.waiting.clone(), self.cache.clone(), self.steps.clone());
        Self { device: self.device.shared(), waiting, cache, steps }
    }

    /// Ends when a frame waits, or the device has failed elsewhere.
    pub(super) async fn arrival(&mut self) {
        tokio::select! {
            () = self.waiting.arrival() => {}
            () = self.device.device_replaced() => {}
        }
    }

    /// Serves what waits already, a few frames at a time. Nothing is kept on a device that has failed elsewhere: it may be lost, or
    /// its memory be needed.
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

    /// Opens the device again after it failed; nothing on a failed device can be used. If it cannot be opened, the CPU
    /// engine replaces it.
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

    /// Serves so that neither a panic nor a failed device is left behind.
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

    /// Renders a task, and between the bands of a dear one those that wait and have a single band.
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
