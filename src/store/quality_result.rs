//! What was found of a model when its job ended.

use serde_json::{Value, json};

use crate::store::sql;
use crate::store::{Store, StoreError};
use relume_api::jobs::JobState;
use relume_api::quality::{Figures, MissedFigure, QualityGate};
use relume_api::{JobId, ModelId};

/// Most warnings that are repeated at the end of a job.
const MAX_WARNINGS: i64 = 100;

/// A model's figures, and those that miss what its job asked for.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct QualityResult {
    /// All of them.
    pub figures: Figures,
    /// Those that are not what was asked for.
    pub missed: Vec<MissedFigure>,
}

impl QualityResult {
    /// Compares `figures` with what a job asks for.
    pub fn new(figures: Figures, gate: &QualityGate) -> Self {
        Self { missed: gate.misses(&figures), figures }
    }

    /// How the job ends.
    pub fn state(&self) -> JobState {
        if self.missed.is_empty() { JobState::Succeeded } else { JobState::Rejected }
    }

    /// What the job's last event says.
    pub(super) fn event(&self, model: &ModelId) -> Value {
        let mut event = json!({ "state": self.state(), "model": model, "figures": self.figures });
        if !self.missed.is_empty() {
            event["missed"] = json!(self.missed);
        }
        event
    }
}

impl Store {
    /// What was warned of in a job's history, in order, each once.
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
