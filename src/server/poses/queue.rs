//! The captures whose poses are being found, with their progress, and the queue for COLMAP.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::OnceCell;
use tokio_util::sync::CancellationToken;

use super::policy::PosesPolicy;
use crate::server::tenant_turns::{TenantTurns, Turn};
use relume_api::captures::{PosesProgress, PosesStage};
use relume_api::{CaptureId, TenantId};
use relume_capture::poses::{PoseProgress, PoseStage, colmap_version};

/// The state of pose estimation for all captures.
pub(in crate::server) struct PoseQueue {
    pub(super) policy: PosesPolicy,
    /// Whether COLMAP can be used or the reason why not, after the first check.
    availability: OnceCell<Result<(), String>>,
    /// COLMAP uses all processors, so only one process runs at a time. Tenants take turns.
    colmap: TenantTurns,
    active: Arc<Mutex<HashMap<CaptureId, ActiveCapture>>>,
}

#[derive(Clone)]
struct ActiveCapture {
    progress: PosesProgress,
    cancelled: CancellationToken,
}

/// The pose estimation of one capture, until this is dropped.
pub(in crate::server) struct PoseJob {
    id: CaptureId,
    active: Arc<Mutex<HashMap<CaptureId, ActiveCapture>>>,
    pub(super) cancelled: CancellationToken,
}

impl PoseQueue {
    pub(in crate::server) fn new(policy: PosesPolicy) -> Self {
        Self { policy, availability: OnceCell::new(), colmap: TenantTurns::default(), active: Arc::default() }
    }

    /// Checks whether poses can be found, and returns the reason if not. COLMAP is tested once per server process.
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

    /// Logs whether photographs without poses are accepted.
    pub(in crate::server) async fn log_availability(&self) {
        match self.check_available().await {
            Ok(()) => tracing::info!("photographs without poses are accepted"),
            Err(reason) => tracing::info!(reason, "photographs without poses are refused"),
        }
    }

    /// The progress of the pose estimation of a capture.
    pub(in crate::server) fn progress(&self, id: &CaptureId) -> Option<PosesProgress> {
        lock(&self.active).get(id).map(|active| active.progress)
    }

    /// Cancels the pose estimation of a capture; `false` if there is none.
    pub(in crate::server) fn cancel(&self, id: &CaptureId) -> bool {
        let active = lock(&self.active).get(id).cloned();
        active.is_some_and(|active| {
            active.cancelled.cancel();
            true
        })
    }

    /// Adds a capture to the queue.
    pub(in crate::server) fn enqueue(&self, id: &CaptureId) -> PoseJob {
        let cancelled = CancellationToken::new();
        let progress = PosesProgress { stage: PosesStage::Waiting, done: 0.0 };
        lock(&self.active).insert(id.clone(), ActiveCapture { progress, cancelled: cancelled.clone() });
        PoseJob { id: id.clone(), active: self.active.clone(), cancelled }
    }

    /// Waits for the turn of a tenant to run COLMAP.
    pub(super) async fn colmap_turn(&self, tenant: &TenantId) -> Turn {
        self.colmap.turn(tenant).await
    }

    /// Waits until COLMAP has ended, which a shutdown of the server causes.
    pub(in crate::server) async fn idle(&self) {
        let _turn = self.colmap.turn(&TenantId::from("")).await;
    }
}

impl PoseJob {
    /// Records the progress.
    pub(super) fn set_progress(&self, PoseProgress { stage, done, total }: PoseProgress) {
        let stage = match stage {
            // Frames are extracted from a clip before the photographs are processed.
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
    // No change of the map can panic halfway, so a poisoned lock is still valid.
    active.lock().unwrap_or_else(PoisonError::into_inner)
}
