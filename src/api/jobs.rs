//! Jobs: trainings, queued and run one after another.
//!
//! [`NewJob`], [`JobProgress`] and [`JobState`] are also what the database holds of a job.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::api::marks::{Marks, MarksChange, given};
use crate::api::quality::{Figures, MissedFigure, QualityGate};
use crate::api::{CaptureId, JobId, ModelId, WorkerId};
use crate::train::{Preset, TrainOverrides};

/// What to train.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema, sqlx::FromRow))]
#[serde(deny_unknown_fields)]
pub struct NewJob {
    /// Identifier of the capture.
    #[cfg_attr(feature = "server", schema(value_type = String), sqlx(rename = "capture_id"))]
    pub capture: CaptureId,
    /// `draft`, `standard` (the default) or `high`.
    #[serde(default)]
    pub preset: Preset,
    /// Changes on top of the preset, e.g. `{"resolution": 200}`; `{"light": {"environment": "ID"}}` holds a known light.
    #[serde(default)]
    #[cfg_attr(feature = "server", sqlx(json))]
    pub overrides: TrainOverrides,
    /// -100 to 100; higher runs first. Above 0 needs a key with the scope `priority`.
    #[serde(default)]
    #[cfg_attr(feature = "server", schema(minimum = -100, maximum = 100))]
    pub priority: i64,
    /// `auto`, `cpu` or `gpu`.
    #[serde(default)]
    pub device: JobDevice,
    /// Labels that a worker must have to be given the job, at most 16.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "server", sqlx(json), schema(max_items = 16))]
    pub requires: Vec<String>,
    /// What the model must reach on held-out views, e.g. `{"novel_view.psnr": ">=28", "novel_view.ssim": ">=0.9"}`. The figures
    /// are `novel_view.psnr`, `novel_view.ssim`, `novel_view_radiance.psnr` and `novel_view_matched.psnr`, the operators `>=`, `>`,
    /// `<=` and `<`. A job whose model misses one ends as `rejected`.
    #[serde(default, skip_serializing_if = "QualityGate::is_empty")]
    #[cfg_attr(feature = "server", schema(value_type = BTreeMap<String, String>), sqlx(json))]
    pub quality_gate: QualityGate,
    /// A name for people, 1 to 200 characters, none of them control characters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "server", schema(min_length = 1, max_length = 200))]
    pub name: Option<String>,
    /// What another system calls it, 1 to 200 characters, none of them control characters. Several jobs may have the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "server", schema(min_length = 1, max_length = 200))]
    pub external_id: Option<String>,
    /// At most 16, keys and values of 1 to 63 of A-Z, a-z, 0-9, `.`, `_`, `-` and `/`. The model gets them, and name and external
    /// identifier, too.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[cfg_attr(feature = "server", sqlx(json))]
    pub labels: BTreeMap<String, String>,
}

impl NewJob {
    /// What it is called.
    pub fn marks(&self) -> Marks {
        Marks { name: self.name.clone(), external_id: self.external_id.clone(), labels: self.labels.clone() }
    }
}

/// Where to train.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema, sqlx::Type))]
#[cfg_attr(feature = "server", schema(as = DeviceChoice), sqlx(type_name = "text", rename_all = "snake_case"))]
pub enum JobDevice {
    /// The device of whichever worker takes it.
    #[default]
    Auto,
    /// The CPU engine.
    Cpu,
    /// A GPU; refused where neither the server nor a worker has one.
    Gpu,
}

/// What may be changed about a job; what is absent stays, what is null goes.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct JobChange {
    /// -100 to 100; higher runs first. Above 0 needs a key with the scope `priority`. Only of a job that waits.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(minimum = -100, maximum = 100))]
    pub priority: Option<i64>,
    /// A name for people, 1 to 200 characters, none of them control characters.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "given")]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>, min_length = 1, max_length = 200))]
    pub name: Option<Option<String>>,
    /// What another system calls it, 1 to 200 characters, none of them control characters.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "given")]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>, min_length = 1, max_length = 200))]
    pub external_id: Option<Option<String>>,
    /// Those that are named; null takes one away, or all of them in place of the object.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "given")]
    #[cfg_attr(feature = "server", schema(value_type = Option<BTreeMap<String, Option<String>>>))]
    pub labels: Option<Option<BTreeMap<String, Option<String>>>>,
}

impl JobChange {
    /// What it shall be called.
    pub fn marks(&self) -> MarksChange {
        let (name, external_id) = (self.name.clone(), self.external_id.clone());
        MarksChange { name, external_id, labels: self.labels.clone() }
    }
}

/// Where a job stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(
    feature = "server",
    derive(utoipa::ToSchema, sqlx::Type),
    sqlx(type_name = "text", rename_all = "snake_case")
)]
pub enum JobState {
    /// Waiting for a worker.
    Queued,
    /// A worker holds its lease.
    Running,
    /// A worker holds its lease and was asked to stop.
    Cancelling,
    /// A model was published. Terminal.
    Succeeded,
    /// A model was published that misses the job's `quality_gate`. Terminal.
    Rejected,
    /// It cannot be trained; the error says why. Terminal.
    Failed,
    /// Stopped on request. Terminal.
    Cancelled,
}

impl JobState {
    /// Every state, in the order of a job's life.
    pub const ALL: [Self; 7] = [
        Self::Queued,
        Self::Running,
        Self::Cancelling,
        Self::Succeeded,
        Self::Rejected,
        Self::Failed,
        Self::Cancelled,
    ];

    /// True when the state never changes again.
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct JobView {
    /// Identifier.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub id: JobId,
    /// Identifier of the capture.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub capture: CaptureId,
    /// What it is called.
    #[serde(flatten)]
    pub marks: Marks,
    /// The job that this one repeats.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>))]
    pub retry_of: Option<JobId>,
    /// Preset.
    pub preset: Preset,
    /// Changes on top of the preset.
    #[serde(serialize_with = "only_those_given")]
    pub overrides: TrainOverrides,
    /// Where it trains.
    pub device: JobDevice,
    /// Labels that a worker must have to be given it.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub requires: Vec<String>,
    /// The worker that has it or had it last.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>))]
    pub worker: Option<WorkerId>,
    /// Higher runs first.
    pub priority: i64,
    /// Where it stands.
    pub state: JobState,
    /// Jobs that run before this one, while it is queued; 1000 stands for that many or more.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub queue_position: Option<i64>,
    /// Progress of the training.
    pub progress: JobProgress,
    /// Times a worker started it.
    pub attempts: i64,
    /// RFC 3339.
    pub created_at: String,
    /// RFC 3339; when a worker first started it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub started_at: Option<String>,
    /// RFC 3339; when it ended.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub finished_at: Option<String>,
    /// What the model must reach.
    #[serde(skip_serializing_if = "QualityGate::is_empty", default)]
    #[cfg_attr(feature = "server", schema(value_type = BTreeMap<String, String>))]
    pub quality_gate: QualityGate,
    /// What was measured on held-out views, once it succeeded or was rejected.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub figures: Option<Figures>,
    /// The figures that are not what was asked for: why it was rejected.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub missed: Vec<MissedFigure>,
    /// Identifier of the model, once it succeeded or was rejected.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>))]
    pub model: Option<ModelId>,
    /// RFC 3339; when that model was deleted.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub model_deleted_at: Option<String>,
    /// Why it failed.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub error: Option<JobError>,
}

/// Progress of a job.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema, sqlx::FromRow))]
pub struct JobProgress {
    /// Steps done.
    pub step: i64,
    /// Steps in all.
    pub total: i64,
    /// The objective.
    pub loss: Option<f64>,
    /// PSNR of the last step's view, dB.
    pub psnr: Option<f64>,
    /// Gaussians now.
    pub gaussians: Option<i64>,
    /// Expected time to the end.
    pub eta_seconds: Option<f64>,
    /// What the worker is doing.
    pub message: Option<String>,
}

/// Why a job failed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct JobError {
    /// Stable code, e.g. `training_failed`, `attempts_exhausted`.
    pub code: String,
    /// A description for the user.
    pub detail: String,
}

/// Leaves out the overrides that were not given.
fn only_those_given<S: serde::Serializer>(overrides: &TrainOverrides, to: S) -> Result<S::Ok, S::Error> {
    // By way of text, which holds the shortest digits of an f32; a `Value` would hold those of an f64.
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
    fn a_view_shows_the_overrides_that_were_given_with_their_own_digits() {
        #[derive(Serialize)]
        struct Shown(#[serde(serialize_with = "only_those_given")] TrainOverrides);
        let overrides = TrainOverrides { warm_up: Some(0.15), seed: Some(3), ..TrainOverrides::default() };
        let text = serde_json::to_string(&Shown(overrides)).unwrap();
        assert_eq!(text, r#"{"seed":3,"warm_up":0.15}"#);
    }
}
