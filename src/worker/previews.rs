//! Previews of a running training: its current model, published only while a client requests previews.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use relume_api::JobId;
use relume_scene::Model;

/// Time after a request for which previews are published.
const WATCH_TIMEOUT: Duration = Duration::from_secs(60);
/// Minimum time between two previews of a training.
const INTERVAL: Duration = Duration::from_secs(2);

/// The state of a training at one step.
#[derive(Clone)]
pub struct Preview {
    /// Completed steps.
    pub step: u32,
    /// The model after these steps.
    pub model: Arc<Model>,
    /// Whether its materials are being trained. Before, the model has only colours.
    pub is_relightable: bool,
}

/// The preview of the running training.
#[derive(Default)]
struct PreviewState {
    /// The running job.
    job: Option<JobId>,
    latest: Option<Preview>,
    /// Time of the latest preview.
    taken: Option<Instant>,
    /// The job of the last request, and its time.
    asked: Option<(JobId, Instant)>,
}

/// The previews of the running training, shared by the training thread and the clients.
#[derive(Default)]
pub(super) struct Previews(Mutex<PreviewState>);

impl Previews {
    /// Sets `job` as the running training until the returned value is dropped.
    pub(super) fn of(self: &Arc<Self>, job: &JobId) -> PreviewPublisher {
        let mut kept = self.lock();
        (kept.job, kept.latest, kept.taken) = (Some(job.clone()), None, None);
        PreviewPublisher(self.clone())
    }

    /// The latest preview of `job`, if it runs. Each call counts as a request.
    pub(super) fn latest(&self, job: &JobId) -> Option<Preview> {
        let mut kept = self.lock();
        kept.asked = Some((job.clone(), Instant::now()));
        kept.latest.clone().filter(|_| kept.job.as_ref() == Some(job))
    }

    fn lock(&self) -> MutexGuard<'_, PreviewState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Publishes the previews of a training.
pub(super) struct PreviewPublisher(Arc<Previews>);

impl PreviewPublisher {
    /// Whether a preview was requested and the last one is old enough.
    pub(super) fn is_due(&self) -> bool {
        let kept = self.0.lock();
        let is_watched = kept
            .asked
            .as_ref()
            .is_some_and(|(job, at)| kept.job.as_ref() == Some(job) && at.elapsed() < WATCH_TIMEOUT);
        is_watched && kept.taken.is_none_or(|at| at.elapsed() >= INTERVAL)
    }

    /// Publishes a preview.
    pub(super) fn show(&self, preview: Preview) {
        let mut kept = self.0.lock();
        (kept.latest, kept.taken) = (Some(preview), Some(Instant::now()));
    }
}

impl Drop for PreviewPublisher {
    fn drop(&mut self) {
        let mut kept = self.0.lock();
        (kept.job, kept.latest) = (None, None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_scene::Gaussians;

    fn preview(step: u32) -> Preview {
        let model = Model::new(Gaussians::zeroed(1, 1, 0, 0), vec![[0.5; 3]], vec![[0.0; 3]; 2], (2, 1));
        Preview { step, model: Arc::new(model), is_relightable: false }
    }

    #[test]
    fn previews_are_rendered_on_request_and_rate_limited() {
        let previews = Arc::new(Previews::default());
        let (job, other) = (JobId::from("job"), JobId::from("other"));
        let shown = previews.of(&job);
        assert!(!shown.is_due(), "no preview was requested");
        assert!(previews.latest(&other).is_none() && !shown.is_due(), "only another job was requested");
        assert!(previews.latest(&job).is_none() && shown.is_due());
        shown.show(preview(7));
        assert!(!shown.is_due(), "the preview is new");
        assert_eq!(previews.latest(&job).map(|preview| preview.step), Some(7));
        assert!(previews.latest(&other).is_none());
        drop(shown);
        assert!(previews.latest(&job).is_none(), "the training has ended");
    }
}
