//! The queue of frames: cheap frames are rendered first, each frame is overtaken a limited number of times, and frames of
//! disconnected callers are removed. Background frames come after all others.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

use crate::worker::queued::Request;
use relume_spec::rendering::Quality;

/// Maximum number of younger, cheaper frames that may overtake a frame.
const MAX_OVERTAKES: u32 = 16;

/// Priority of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RenderPriority {
    /// A client waits for the frame.
    Interactive,
    /// An export. It is rendered when no interactive frame is queued.
    Background,
}

/// The sending side of the queue.
#[derive(Clone)]
pub(super) struct RenderQueue(Arc<QueueInner>);

/// The receiving side of the queue, for one or several threads. When the last one is dropped, waiting callers get the answer that
/// the device is busy.
#[derive(Clone)]
pub(super) struct RenderReceiver {
    queue: Arc<QueueInner>,
    _last: Arc<CloseOnDrop>,
}

/// Closes the queue when it is dropped.
struct CloseOnDrop(Arc<QueueInner>);

/// A caller's entry in the queue. When it is dropped, its frame is removed from the queue.
pub(super) struct QueueSlot {
    queue: Arc<QueueInner>,
    id: u64,
}

struct QueueInner {
    capacity: usize,
    state: Mutex<QueueState>,
    arrived: Notify,
}

#[derive(Default)]
struct QueueState {
    next: u64,
    closed: bool,
    /// In order of arrival.
    waiting: Vec<QueueEntry>,
}

struct QueueEntry {
    id: u64,
    cost: u64,
    priority: RenderPriority,
    /// Number of younger frames that were rendered before it.
    overtaken: u32,
    request: Request,
}

/// A queue of at most `capacity` frames.
pub(super) fn render_queue(capacity: usize) -> (RenderQueue, RenderReceiver) {
    let shared = Arc::new(QueueInner { capacity, state: Mutex::default(), arrived: Notify::new() });
    let waiting = RenderReceiver { queue: shared.clone(), _last: Arc::new(CloseOnDrop(shared.clone())) };
    (RenderQueue(shared), waiting)
}

impl QueueInner {
    fn lock(&self) -> MutexGuard<'_, QueueState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl RenderQueue {
    /// Queues a request; `None` if the queue is full or no receiver exists.
    pub(super) fn push(&self, request: Request, priority: RenderPriority) -> Option<QueueSlot> {
        let mut state = self.0.lock();
        if state.closed || state.waiting.len() >= self.0.capacity {
            return None;
        }
        let id = state.next;
        state.next += 1;
        let cost = request.cost();
        state.waiting.push(QueueEntry { id, cost, priority, overtaken: 0, request });
        self.0.arrived.notify_one();
        Some(QueueSlot { queue: self.0.clone(), id })
    }

    /// Whether no receiver exists.
    pub(super) fn is_closed(&self) -> bool {
        self.0.lock().closed
    }
}

impl RenderReceiver {
    /// Waits until a frame is queued.
    pub(super) async fn arrival(&mut self) {
        while self.queue.lock().waiting.is_empty() {
            self.queue.arrived.notified().await;
        }
    }

    /// The next frame to render: the oldest that was overtaken too often, otherwise the cheapest interactive frame, otherwise the
    /// cheapest background frame.
    pub(super) fn try_recv(&mut self) -> Option<Request> {
        let mut state = self.queue.lock();
        let waiting = &mut state.waiting;
        let patient = waiting
            .iter()
            .position(|e| e.priority == RenderPriority::Interactive && e.overtaken >= MAX_OVERTAKES);
        let cheapest = || {
            (0..waiting.len())
                .min_by_key(|&i| (waiting[i].priority == RenderPriority::Background, waiting[i].cost))
        };
        let next = patient.or_else(cheapest)?;
        waiting[..next].iter_mut().for_each(|entry| entry.overtaken += 1);
        Some(waiting.remove(next).request)
    }

    /// The cheapest interactive frame, if it has a single band. It may be rendered between the bands of another frame.
    pub(super) fn try_recv_cheap(&mut self) -> Option<Request> {
        let mut state = self.queue.lock();
        let waiting = &mut state.waiting;
        let looked_at = (0..waiting.len()).filter(|&i| waiting[i].priority == RenderPriority::Interactive);
        let cheapest = looked_at.min_by_key(|&i| waiting[i].cost)?;
        (waiting[cheapest].cost <= Quality::CPU_BAND_COST).then(|| waiting.remove(cheapest).request)
    }
}

impl Drop for CloseOnDrop {
    fn drop(&mut self) {
        let mut state = self.0.lock();
        state.closed = true;
        state.waiting.clear();
    }
}

impl Drop for QueueSlot {
    fn drop(&mut self) {
        self.queue.lock().waiting.retain(|entry| entry.id != self.id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::worker::queued::Queued;
    use crate::worker::{LightSource, LightTask, ModelContent, ModelSource, RenderTask};
    use relume_spec::rendering::{Output, Tier};
    use relume_train::render::{Neighbours, Orbit, Viewpoint};

    fn task(size: u32, tier: Tier) -> RenderTask {
        RenderTask {
            model: ModelSource::new("model".into(), ModelContent::File("model".into())),
            light: LightSource::Recovered,
            rotation_deg: 0.0,
            exposure_ev: 0.0,
            shows_environment: false,
            viewpoint: Viewpoint::Orbit(Orbit { azimuth_deg: Some(0.0), elevation_deg: Some(0.0), size }),
            quality: tier.into(),
            outputs: vec![Output::Rgb],
            ground_height: None,
            lamps: Vec::new(),
            neighbours: Neighbours::default(),
        }
    }

    fn light() -> LightTask {
        let model = ModelSource::new("model".into(), ModelContent::File("model".into()));
        LightTask { model, light: LightSource::Recovered, rotation_deg: 0.0, with_map: false }
    }

    /// Queues a frame with a size; the returned slot stands for its caller.
    fn push(queue: &RenderQueue, size: u32) -> Option<QueueSlot> {
        push_as(queue, size, RenderPriority::Interactive)
    }

    fn push_as(queue: &RenderQueue, size: u32, priority: RenderPriority) -> Option<QueueSlot> {
        queue.push(Request::frame(Queued::new(task(size, Tier::Standard), 0).0), priority)
    }

    /// Side of a frame; `None` for a light.
    fn size_of(request: &Request) -> Option<u32> {
        match request {
            Request::Frame(frame) => Some(frame.task.pixels().isqrt() as u32),
            Request::Light(_) => None,
        }
    }

    fn next_size(waiting: &mut RenderReceiver) -> u32 {
        size_of(&waiting.try_recv().unwrap()).unwrap()
    }

    #[test]
    fn frame_cost_grows_with_pixels_and_tier() {
        let costs = Tier::ALL.map(|tier| task(64, tier).cost());
        assert!(costs.is_sorted() && costs[3] > 10 * costs[2], "{costs:?}");
        assert!(task(4096, Tier::Preview).cost() > task(256, Tier::High).cost());
    }

    #[test]
    fn cheap_frames_are_rendered_first_and_equal_ones_in_order() {
        let (queue, mut waiting) = render_queue(9);
        let _places = [1024, 64, 256, 64].map(|size| push(&queue, size).unwrap());
        assert_eq!([(); 4].map(|()| next_size(&mut waiting)), [64, 64, 256, 1024]);
        assert!(waiting.try_recv().is_none());
    }

    #[test]
    fn only_cheap_frames_run_between_bands_of_a_large_frame() {
        let (queue, mut waiting) = render_queue(9);
        let _places = [2048, 128, 64].map(|size| push(&queue, size).unwrap());
        let (light, _answer) = Queued::new(light(), 0);
        let _light = queue.push(Request::light(light), RenderPriority::Interactive).unwrap();
        let mut next = || waiting.try_recv_cheap().as_ref().map(size_of);
        assert_eq!([(); 3].map(|()| next()), [Some(Some(64)), Some(Some(128)), None]);
        assert_eq!(size_of(&waiting.try_recv().unwrap()), None, "a light is not served between bands");
        assert_eq!(next_size(&mut waiting), 2048, "and so does the frame");
    }

    #[test]
    fn background_frames_are_rendered_after_all_interactive_ones() {
        let (queue, mut waiting) = render_queue(99);
        let _export = push_as(&queue, 32, RenderPriority::Background).unwrap();
        assert!(waiting.try_recv_cheap().is_none(), "not between the bands of another");
        for _ in 0..3 * MAX_OVERTAKES {
            let _looked_at = push(&queue, 1024).unwrap();
            assert_eq!(next_size(&mut waiting), 1024, "independent of cost and waiting time");
        }
        assert_eq!(next_size(&mut waiting), 32);
        let _control = push(&queue, 32).unwrap();
        assert!(waiting.try_recv_cheap().is_some(), "the control: the same frame as interactive");
    }

    #[test]
    fn an_expensive_frame_is_overtaken_a_limited_number_of_times() {
        let (queue, mut waiting) = render_queue(9);
        let _dear = push(&queue, 1024).unwrap();
        let mut before = 0;
        loop {
            let _cheap = push(&queue, 64).unwrap();
            if next_size(&mut waiting) == 1024 {
                break;
            }
            before += 1;
        }
        assert_eq!(before, MAX_OVERTAKES);
    }

    #[tokio::test]
    async fn frames_of_disconnected_callers_leave_the_queue_at_once() {
        let (queue, mut waiting) = render_queue(2);
        let (gone, _stays) = (push(&queue, 64).unwrap(), push(&queue, 128).unwrap());
        assert!(push(&queue, 256).is_none(), "the queue is full");
        drop(gone);
        let _late = push(&queue, 256).unwrap();
        assert_eq!([(); 2].map(|()| next_size(&mut waiting)), [128, 256]);
        let waited = tokio::time::timeout(std::time::Duration::from_millis(1), waiting.arrival()).await;
        assert!(waited.is_err(), "nothing is left");
    }

    #[tokio::test]
    async fn queued_callers_get_an_error_when_the_renderer_stops() {
        let (queue, waiting) = render_queue(2);
        let (render, frame) = Queued::new(task(64, Tier::Standard), 0);
        let _place = queue.push(Request::frame(render), RenderPriority::Interactive).unwrap();
        let other = waiting.clone();
        drop(waiting);
        assert!(!queue.is_closed(), "the control: another one renders");
        drop(other);
        assert!(frame.await.is_err() && queue.is_closed());
        assert!(push(&queue, 64).is_none());
    }
}
