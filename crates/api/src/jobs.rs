//! Jobs: trainings in a queue.
//!
//! The database stores [`NewJob`], [`JobProgress`] and [`JobState`] of each job.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::metadata::{MetadataChange, ResourceMetadata, given};
use crate::quality::{Figures, MissedFigure, QualityGate};
use crate::{CaptureId, JobId, ModelId, WorkerId};
use relume_spec::training::{Preset, TrainOverrides};

/// A training to queue.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[cfg_attr(feature = "sqlx", derive(sqlx::FromRow))]
#[serde(deny_unknown_fields)]
pub struct NewJob {
    /// Identifier of the capture.
    #[schema(value_type = String)]
    #[cfg_attr(feature = "sqlx", sqlx(rename = "capture_id"))]
    pub capture: CaptureId,
    /// Preset: `draft`, `standard` or `high`. Omitted: `standard`. Ignored with `overrides.time_budget_s`.
    #[serde(default)]
    pub preset: Preset,
    /// Settings that replace values of the preset, e.g. `{"resolution": 200}`.
    /// `{"light": {"environment": "ID"}}` fixes the light to a known environment map.
    #[serde(default)]
    #[cfg_attr(feature = "sqlx", sqlx(json))]
    pub overrides: TrainOverrides,
    /// Priority, -100 to 100. Jobs with a higher priority run first; within a priority, tenants take turns. A
    /// running job returns to the queue with its checkpoint if a job of a higher priority, or of a tenant
    /// without a running job, waits after its time slice of 30 seconds or more. A value above 0 requires a key
    /// with the scope `priority`. Omitted: 0.
    #[serde(default)]
    #[schema(minimum = -100, maximum = 100)]
    pub priority: i64,
    /// Device: `auto`, `cpu` or `gpu`. Omitted: `auto`.
    #[serde(default)]
    pub device: JobDevice,
    /// Labels that a worker must have to claim the job, at most 16. Labels have 1 to 63 characters of A-Z,
    /// a-z, 0-9, `.`, `_`, `-`, `/` and `:`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schema(max_items = 16)]
    #[cfg_attr(feature = "sqlx", sqlx(json))]
    pub requires: Vec<String>,
    /// Bounds that the model must meet on held-out views, e.g.
    /// `{"novel_view.psnr": ">=28", "novel_view.ssim": ">=0.9"}`. Figures: `novel_view.psnr`,
    /// `novel_view.ssim`, `novel_view_radiance.psnr` and `novel_view_matched.psnr`. Operators: `>=`, `>`,
    /// `<=` and `<`. If the model misses a bound, the job ends in the state `rejected`.
    #[serde(default, skip_serializing_if = "QualityGate::is_empty")]
    #[schema(value_type = BTreeMap<String, String>)]
    #[cfg_attr(feature = "sqlx", sqlx(json))]
    pub quality_gate: QualityGate,
    /// Display name, 1 to 200 characters without control characters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200)]
    pub name: Option<String>,
    /// Identifier in another system, 1 to 200 characters without control characters. Several jobs may have
    /// the same one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200)]
    pub external_id: Option<String>,
    /// Labels, at most 16. Keys and values have 1 to 63 characters of A-Z, a-z, 0-9, `.`, `_`, `-` and `/`.
    /// The model inherits name, external identifier and labels.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[cfg_attr(feature = "sqlx", sqlx(json))]
    pub labels: BTreeMap<String, String>,
}

impl NewJob {
    /// Name, external identifier and labels.
    pub fn metadata(&self) -> ResourceMetadata {
        ResourceMetadata {
            name: self.name.clone(),
            external_id: self.external_id.clone(),
            labels: self.labels.clone(),
        }
    }
}

/// Training device.
///
/// `auto`: the device of the worker that claims the job. `cpu`: the CPU engine. `gpu`: a GPU; the server
/// refuses the job if neither the server nor a worker has one.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[derive(utoipa::ToSchema)]
#[cfg_attr(feature = "sqlx", derive(sqlx::Type))]
#[schema(as = DeviceChoice)]
#[cfg_attr(feature = "sqlx", sqlx(type_name = "text", rename_all = "snake_case"))]
pub enum JobDevice {
    /// The device of the worker that claims the job.
    #[default]
    Auto,
    /// The CPU engine.
    Cpu,
    /// A GPU. The server refuses the job if neither the server nor a worker has one.
    Gpu,
}

/// A change of a job. Omitted fields are unchanged; null clears a field.
#[derive(Debug, Clone, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JobChange {
    /// Priority of a queued job, -100 to 100. Jobs with a higher priority run first. A value above 0 requires
    /// a key with the scope `priority`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = -100, maximum = 100)]
    pub priority: Option<i64>,
    /// Display name, 1 to 200 characters without control characters.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "given")]
    #[schema(value_type = Option<String>, min_length = 1, max_length = 200)]
    pub name: Option<Option<String>>,
    /// Identifier in another system, 1 to 200 characters without control characters.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "given")]
    #[schema(value_type = Option<String>, min_length = 1, max_length = 200)]
    pub external_id: Option<Option<String>>,
    /// Labels to set. Omitted labels are unchanged; null removes a label. null instead of the object removes
    /// all labels.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "given")]
    #[schema(value_type = Option<BTreeMap<String, Option<String>>>)]
    pub labels: Option<Option<BTreeMap<String, Option<String>>>>,
}

impl JobChange {
    /// The change of name, external identifier and labels.
    pub fn metadata(&self) -> MetadataChange {
        let (name, external_id) = (self.name.clone(), self.external_id.clone());
        MetadataChange { name, external_id, labels: self.labels.clone() }
    }
}

/// State of a job.
///
/// `queued`: waits for a worker. `running`: a worker holds the lease. `cancelling`: a worker holds the lease
/// and was asked to stop. Final states: `succeeded`: the model is published. `rejected`: the model is
/// published and misses the job's `quality_gate`. `failed`: the training failed; `error` has the reason.
/// `cancelled`: a caller cancelled the job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[derive(utoipa::ToSchema)]
#[cfg_attr(feature = "sqlx", derive(sqlx::Type), sqlx(type_name = "text", rename_all = "snake_case"))]
pub enum JobState {
    /// The job waits for a worker.
    Queued,
    /// A worker holds the lease.
    Running,
    /// A worker holds the lease and was asked to stop.
    Cancelling,
    /// The model is published. Final.
    Succeeded,
    /// The model is published and misses the job's `quality_gate`. Final.
    Rejected,
    /// The training failed; `error` has the reason. Final.
    Failed,
    /// A caller cancelled the job. Final.
    Cancelled,
}

impl JobState {
    /// All states, in the order in which a job passes through them.
    pub const ALL: [Self; 7] = [
        Self::Queued,
        Self::Running,
        Self::Cancelling,
        Self::Succeeded,
        Self::Rejected,
        Self::Failed,
        Self::Cancelled,
    ];

    /// True if the state is final.
    pub fn is_terminal(self) -> bool {
        matches!(self, Self::Succeeded | Self::Rejected | Self::Failed | Self::Cancelled)
    }

    /// The state's name in the API and the database.
    pub fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Cancelling => "cancelling",
            Self::Succeeded => "succeeded",
            Self::Rejected => "rejected",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }
}

/// A job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct JobView {
    /// Identifier.
    #[schema(value_type = String)]
    pub id: JobId,
    /// Identifier of the capture.
    #[schema(value_type = String)]
    pub capture: CaptureId,
    /// Name, external identifier and labels.
    #[serde(flatten)]
    pub metadata: ResourceMetadata,
    /// Identifier of the job that this job repeats.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>)]
    pub retry_of: Option<JobId>,
    /// Preset.
    pub preset: Preset,
    /// Settings that replace values of the preset.
    #[serde(serialize_with = "only_those_given")]
    pub overrides: TrainOverrides,
    /// Requested device.
    pub device: JobDevice,
    /// Labels that a worker must have to claim the job.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub requires: Vec<String>,
    /// Identifier of the worker that holds the job, or that held it last.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>)]
    pub worker: Option<WorkerId>,
    /// Priority. Jobs with a higher priority run first.
    pub priority: i64,
    /// State.
    pub state: JobState,
    /// Number of jobs ahead in the queue, in the state `queued`. 1000 means 1000 or more.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub queue_position: Option<i64>,
    /// Progress of the training.
    pub progress: JobProgress,
    /// Number of attempts that workers started.
    pub attempts: i64,
    /// Creation time, RFC 3339.
    pub created_at: String,
    /// Time of the first start by a worker, RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub started_at: Option<String>,
    /// Time of the final state, RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub finished_at: Option<String>,
    /// Bounds that the model must meet.
    #[serde(skip_serializing_if = "QualityGate::is_empty", default)]
    #[schema(value_type = BTreeMap<String, String>)]
    pub quality_gate: QualityGate,
    /// Figures measured on held-out views, in the states `succeeded` and `rejected`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub figures: Option<Figures>,
    /// Bounds that the model misses: the reason of the state `rejected`.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub missed: Vec<MissedFigure>,
    /// Identifier of the model, in the states `succeeded` and `rejected`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>)]
    pub model: Option<ModelId>,
    /// Time of the deletion of the model, RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub model_deleted_at: Option<String>,
    /// Reason of the state `failed`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub error: Option<JobError>,
}

/// Progress of a job.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[cfg_attr(feature = "sqlx", derive(sqlx::FromRow))]
pub struct JobProgress {
    /// Completed steps.
    pub step: i64,
    /// Total number of steps. With a time budget or a stop condition it changes during the training.
    pub total: i64,
    /// Value of the training objective.
    pub loss: Option<f64>,
    /// PSNR of the last step's view, dB.
    pub psnr: Option<f64>,
    /// Current number of Gaussians.
    pub gaussians: Option<i64>,
    /// Estimated remaining time, seconds.
    pub eta_seconds: Option<f64>,
    /// Current activity of the worker.
    pub message: Option<String>,
}

/// Failure of a job or an export.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct JobError {
    /// Stable code, e.g. `training_failed`, `attempts_exhausted`.
    pub code: String,
    /// A description for the user.
    pub detail: String,
}

/// Serialises the given overrides only.
fn only_those_given<S: serde::Serializer>(overrides: &TrainOverrides, to: S) -> Result<S::Ok, S::Error> {
    // Serialised through text, which has the shortest digits of an f32; a `Value` would have those of an f64.
    let text = serde_json::to_string(overrides).map_err(serde::ser::Error::custom)?;
    let mut fields: serde_json::Map<String, serde_json::Value> =
        serde_json::from_str(&text).map_err(serde::ser::Error::custom)?;
    fields.retain(|_, given| !given.is_null());
    fields.serialize(to)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn view_shows_only_given_overrides_with_unchanged_digits() {
        #[derive(Serialize)]
        struct Shown(#[serde(serialize_with = "only_those_given")] TrainOverrides);
        let overrides = TrainOverrides { warm_up: Some(0.15), seed: Some(3), ..TrainOverrides::default() };
        let text = serde_json::to_string(&Shown(overrides)).unwrap();
        assert_eq!(text, r#"{"seed":3,"warm_up":0.15}"#);
    }
}
