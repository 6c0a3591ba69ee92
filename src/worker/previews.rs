//! How a running training looks: its model as it stands, taken while somebody watches. A training that nobody watches pays nothing.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use relume_api::JobId;
use relume_scene::Model;

/// How long somebody who asked counts as watching.
const WATCH_TIMEOUT: Duration = Duration::from_secs(60);
/// Least time between two looks at a training.
const INTERVAL: Duration = Duration::from_secs(2);

/// A training at one moment.
#[derive(Clone)]
pub struct Preview {
    /// Steps done.
    pub step: u32,
    /// The model after these.
    pub model: Arc<Model>,
    /// Whether its materials are being trained; before that it has colour alone.
    pub is_relightable: bool,
}

/// What is kept of the training that runs.
#[derive(Default)]
struct PreviewState {
    /// The job that trains.
    job: Option<JobId>,
    latest: Option<Preview>,
    /// When it was taken.
    taken: Option<Instant>,
    /// Which job somebody asked for last, and when.
    asked: Option<(JobId, Instant)>,
}

/// The looks of the training that runs, between the thread that trains and those who ask.
#[derive(Default)]
pub(super) struct Previews(Mutex<PreviewState>);

impl Previews {
    /// From now on `job` trains, until what this returns is dropped.
    pub(super) fn of(self: &Arc<Self>, job: &JobId) -> PreviewPublisher {
        let mut kept = self.lock();
        (kept.job, kept.latest, kept.taken) = (Some(job.clone()), None, None);
        PreviewPublisher(self.clone())
    }

    /// How `job` looked last, if it trains. Whoever asks is watching.
    pub(super) fn latest(&self, job: &JobId) -> Option<Preview> {
        let mut kept = self.lock();
        kept.asked = Some((job.clone(), Instant::now()));
        kept.latest.clone().filter(|_| kept.job.as_ref() == Some(job))
    }

    fn lock(&self) -> MutexGuard<'_, PreviewState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The training that is shown.
pub(super) struct PreviewPublisher(Arc<Previews>);

impl PreviewPublisher {
    /// Whether somebody watches and has not seen the training for a while.
    pub(super) fn is_due(&self) -> bool {
        let kept = self.0.lock();
        let is_watched = kept
            .asked
            .as_ref()
            .is_some_and(|(job, at)| kept.job.as_ref() == Some(job) && at.elapsed() < WATCH_TIMEOUT);
        is_watched && kept.taken.is_none_or(|at| at.elapsed() >= INTERVAL)
    }

    /// Shows this from now on.
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
    use relume_scene::{Gaussians, ShadingOptions};

    fn preview(step: u32) -> Preview {
        let model = Model {
            gaussians: Gaussians::zeroed(1, 1, 0, 0),
            prototypes: vec![[0.5; 3]],
            env_raw: vec![[0.0; 3]; 2],
            env_width: 2,
            env_height: 1,
            lights: Default::default(),
            shading: ShadingOptions::default(),
            world_scale: 1.0,
            world_offset: glam::DVec3::ZERO,
            framing: None,
            card: serde_json::Value::Null,
        };
        Preview { step, model: Arc::new(model), is_relightable: false }
    }

    #[test]
    fn previews_are_rendered_on_request_and_rate_limited() {
        let previews = Arc::new(Previews::default());
        let (job, other) = (JobId::from("job"), JobId::from("other"));
        let shown = previews.of(&job);
        assert!(!shown.is_due(), "nobody asked");
        assert!(previews.latest(&other).is_none() && !shown.is_due(), "somebody asked for another");
        assert!(previews.latest(&job).is_none() && shown.is_due());
        shown.show(preview(7));
        assert!(!shown.is_due(), "it was just taken");
        assert_eq!(previews.latest(&job).map(|preview| preview.step), Some(7));
        assert!(previews.latest(&other).is_none());
        drop(shown);
        assert!(previews.latest(&job).is_none(), "it trains no more");
    }
}
