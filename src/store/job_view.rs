//! The view of a job in the API.

use crate::store::JobRecord;
use relume_api::jobs::{JobError, JobView};

impl JobRecord {
    /// The job as the API shows it. `queue_position` is the number of jobs before it while it is queued.
    pub fn view(self, queue_position: Option<i64>) -> JobView {
        let detail = self.error_detail.unwrap_or_default();
        JobView {
            id: self.id,
            metadata: self.request.metadata(),
            capture: self.request.capture,
            retry_of: self.retry_of,
            preset: self.request.preset,
            overrides: self.request.overrides,
            device: self.request.device,
            requires: self.request.requires,
            worker: self.worker,
            priority: self.request.priority,
            state: self.state,
            queue_position,
            progress: self.progress,
            attempts: self.attempts,
            created_at: rfc3339(self.created_ms),
            started_at: self.started_ms.map(rfc3339),
            finished_at: self.finished_ms.map(rfc3339),
            model: self.model_id,
            model_deleted_at: self.model_deleted_ms.map(rfc3339),
            missed: self.figures.as_ref().map(|f| self.request.quality_gate.misses(f)).unwrap_or_default(),
            quality_gate: self.request.quality_gate,
            figures: self.figures,
            error: self.error_code.map(|code| JobError { code, detail }),
        }
    }
}

/// Milliseconds since 1970 UTC as RFC 3339.
pub fn rfc3339(ms: i64) -> String {
    jiff::Timestamp::from_millisecond(ms).unwrap_or_default().to_string()
}
