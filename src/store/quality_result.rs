//! The quality of a model at the end of its job.

use serde_json::{Value, json};

use crate::store::{Store, StoreError, sql};
use relume_api::jobs::JobState;
use relume_api::quality::{Figures, MissedFigure, QualityGate};
use relume_api::{JobId, ModelId};

/// Maximum number of warnings that are repeated at the end of a job.
const MAX_WARNINGS: i64 = 100;

/// The figures of a model, and those that miss the quality gate.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct QualityResult {
    /// All figures.
    pub figures: Figures,
    /// Figures that miss the quality gate.
    pub missed: Vec<MissedFigure>,
}

impl QualityResult {
    /// Compares `figures` with the quality gate of a job.
    pub fn new(figures: Figures, gate: &QualityGate) -> Self {
        Self { missed: gate.misses(&figures), figures }
    }

    /// The state in which the job ends.
    pub fn state(&self) -> JobState {
        if self.missed.is_empty() { JobState::Succeeded } else { JobState::Rejected }
    }

    /// The data of the job's last event.
    pub(super) fn event(&self, model: &ModelId) -> Value {
        let mut event = json!({ "state": self.state(), "model": model, "figures": self.figures });
        if !self.missed.is_empty() {
            event["missed"] = json!(self.missed);
        }
        event
    }
}

impl Store {
    /// The distinct warnings in a job's history, in order.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn warnings(&self, job: &JobId) -> Result<Vec<String>, StoreError> {
        let query = sql::query_scalar(
            "SELECT data FROM events WHERE job_id = $1 AND kind = 'warning'
             GROUP BY data ORDER BY MIN(seq) LIMIT $2",
        );
        let found: Vec<String> = query.bind(job).bind(MAX_WARNINGS).fetch_all(self.pool()).await?;
        Ok(found.iter().filter_map(|data| message_of(data)).collect())
    }
}

/// The message in the data of a warning.
fn message_of(data: &str) -> Option<String> {
    let data: Value = serde_json::from_str(data).ok()?;
    data["message"].as_str().map(str::to_owned)
}
