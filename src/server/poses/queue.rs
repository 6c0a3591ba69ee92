//! Which captures poses are being found for, how far each is, and who waits for its turn.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{OnceCell, OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;

use super::policy::PosesPolicy;
use crate::server::problem::Problem;
use relume_api::CaptureId;
use relume_api::captures::{PosesProgress, PosesStage};
use relume_capture::poses::{PoseProgress, PoseStage, colmap_version};

/// The work on all captures.
pub(in crate::server) struct PoseQueue {
    pub(super) policy: PosesPolicy,
    /// Why COLMAP cannot be used, once that is known.
    availability: OnceCell<Result<(), String>>,
    /// COLMAP takes all processors, so that there is one at a time.
    colmap_permit: Arc<Semaphore>,
    active: Arc<Mutex<HashMap<CaptureId, ActiveCapture>>>,
}

#[derive(Clone)]
struct ActiveCapture {
    progress: PosesProgress,
    cancelled: CancellationToken,
}

/// Work on one capture, until this is dropped.
pub(in crate::server) struct PoseJob {
    id: CaptureId,
    active: Arc<Mutex<HashMap<CaptureId, ActiveCapture>>>,
    pub(super) cancelled: CancellationToken,
}

impl PoseQueue {
    pub(in crate::server) fn new(policy: PosesPolicy) -> Self {
        let colmap_permit = Arc::new(Semaphore::new(1));
        Self { policy, availability: OnceCell::new(), colmap_permit, active: Arc::default() }
    }

    /// Whether poses can be found here, or why not. COLMAP is tried once in the life of a server.
    pub(super) async fn check_available(&self) -> Result<(), String> {
        if !self.policy.is_on {
            return Err("pose estimation is off (--poses off)".to_owned());
        }
        let try_it = || async {
            let options = self.policy.options();
            let tried = move || {
                let log = tempfile::NamedTempFile::new().map_err(|error| error.to_string())?;
                colmap_version(&options, log.path()).map_err(|error| error.to_string())
            };
            match tokio::task::spawn_blocking(tried).await {
                Ok(Ok(_)) => Ok(()),
                Ok(Err(reason)) => Err(reason),
                Err(error) => Err(error.to_string()),
            }
        };
        self.availability.get_or_init(try_it).await.clone()
    }

    /// Says in the log whether photographs without poses are taken.
    pub(in crate::server) async fn log_availability(&self) {
        match self.check_available().await {
            Ok(()) => tracing::info!("photographs without poses are taken"),
            Err(reason) => tracing::info!(reason, "photographs without poses are refused"),
        }
    }

    /// How far a capture is that poses are being found for.
    pub(in crate::server) fn progress(&self, id: &CaptureId) -> Option<PosesProgress> {
        lock(&self.active).get(id).map(|active| active.progress)
    }

    /// Ends the work on a capture soon; `false` where there is none.
    pub(in crate::server) fn cancel(&self, id: &CaptureId) -> bool {
        let active = lock(&self.active).get(id).cloned();
        active.is_some_and(|active| {
            active.cancelled.cancel();
            true
        })
    }

    /// Enters a capture, which waits from now on.
    pub(in crate::server) fn enqueue(&self, id: &CaptureId) -> PoseJob {
        let cancelled = CancellationToken::new();
        let progress = PosesProgress { stage: PosesStage::Waiting, done: 0.0 };
        lock(&self.active).insert(id.clone(), ActiveCapture { progress, cancelled: cancelled.clone() });
        PoseJob { id: id.clone(), active: self.active.clone(), cancelled }
    }

    /// Waits until COLMAP works on nothing else.
    ///
    /// # Errors
    /// Never while the server runs.
    pub(super) async fn colmap_permit(&self) -> Result<OwnedSemaphorePermit, Problem> {
        self.colmap_permit.clone().acquire_owned().await.map_err(Problem::internal)
    }

    /// Waits until COLMAP has ended, which the end of the server makes it do.
    pub(in crate::server) async fn idle(&self) {
        let _ = self.colmap_permit.acquire().await;
    }
}

impl PoseJob {
    /// Writes down how far the work is.
    pub(super) fn set_progress(&self, PoseProgress { stage, done, total }: PoseProgress) {
        let stage = match stage {
            // Frames of a clip come before photographs.
            PoseStage::Frames | PoseStage::Features => PosesStage::Features,
            PoseStage::Matching => PosesStage::Matching,
            PoseStage::Mapping => PosesStage::Placing,
        };
        let done = (done as f64 / total.max(1) as f64).clamp(0.0, 1.0);
        if let Some(active) = lock(&self.active).get_mut(&self.id) {
            active.progress = PosesProgress { stage, done };
        }
    }
}

impl Drop for PoseJob {
    fn drop(&mut self) {
        lock(&self.active).remove(&self.id);
    }
}

fn lock(
    active: &Mutex<HashMap<CaptureId, ActiveCapture>>,
) -> std::sync::MutexGuard<'_, HashMap<CaptureId, ActiveCapture>> {
    // Each change of it is one that cannot panic halfway.
    active.lock().unwrap_or_else(PoisonError::into_inner)
}
