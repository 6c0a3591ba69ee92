//! Supplies the photographs of steps: decoded ahead, and only if the engine does not hold them.

use std::sync::Arc;

use crate::schedule;
use crate::trainer::Trainer;
use relume_engine::{Photo, PhotoId};

/// Number of steps whose photographs are decoded ahead, as far as the cache has room.
const AHEAD: u32 = 4;

impl Trainer {
    /// The photograph of a step, without pixels if the engine holds it. The photographs of the next steps are decoded
    /// meanwhile.
    pub(super) fn photograph(&self, id: PhotoId) -> Arc<Photo> {
        let _span = tracing::debug_span!("photograph").entered();
        let photo = match self.engine.holds(id) {
            true => Arc::new(self.data.without_pixels(id.index, id.size)),
            false => self.data.photo(id.index, id.size),
        };
        let missing = self.next_photos().into_iter().filter(|id| !self.engine.holds(*id));
        self.data.prefetch(missing.map(|id| (id.index, id.size)));
        photo
    }

    /// Photographs of the steps after the current one.
    fn next_photos(&self) -> Vec<PhotoId> {
        let next = self.schedule.step + 1;
        let timeline = &self.schedule.timeline;
        let steps = next..timeline.total().max(next).min(next + AHEAD);
        let (photos, revision) = (self.schedule.next_photos(steps.len()), self.schedule.revision());
        let size = |step| schedule::photo_size(&self.config, timeline.position(step));
        let named = |(index, step)| PhotoId { index, size: size(step), revision };
        photos.into_iter().zip(steps).map(named).collect()
    }
}
