//! Webhooks: what a server tells others by itself, as [Standard Webhooks](https://www.standardwebhooks.com) has it.

use serde::{Deserialize, Serialize};

use crate::api::jobs::{JobState, JobView};
use crate::api::marks::{NO_CONTROL, has_control};
use crate::api::{DeliveryId, JobId, KeyId, WebhookId};

/// What a webhook is told of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema, sqlx::Type), sqlx(type_name = "text"))]
pub enum WebhookEvent {
    /// A job has made a model.
    #[serde(rename = "job.succeeded")]
    #[cfg_attr(feature = "server", sqlx(rename = "job.succeeded"))]
    JobSucceeded,
    /// A job has made a model that misses its quality gate.
    #[serde(rename = "job.rejected")]
    #[cfg_attr(feature = "server", sqlx(rename = "job.rejected"))]
    JobRejected,
    /// A job cannot be trained.
    #[serde(rename = "job.failed")]
    #[cfg_attr(feature = "server", sqlx(rename = "job.failed"))]
    JobFailed,
    /// A job was stopped on request.
    #[serde(rename = "job.cancelled")]
    #[cfg_attr(feature = "server", sqlx(rename = "job.cancelled"))]
    JobCancelled,
}

impl WebhookEvent {
    /// The event of a job that is in a state now; none while it may still change.
    pub fn of(state: JobState) -> Option<Self> {
        match state {
            JobState::Queued | JobState::Running | JobState::Cancelling => None,
            JobState::Succeeded => Some(Self::JobSucceeded),
            JobState::Rejected => Some(Self::JobRejected),
            JobState::Failed => Some(Self::JobFailed),
            JobState::Cancelled => Some(Self::JobCancelled),
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::JobSucceeded => "job.succeeded",
            Self::JobRejected => "job.rejected",
            Self::JobFailed => "job.failed",
            Self::JobCancelled => "job.cancelled",
        }
    }
}

/// A webhook to be made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct NewWebhook {
    /// Where it is sent to: `https://...`, at an address that is public. Operators may allow others.
    #[cfg_attr(feature = "server", schema(min_length = 1, max_length = 2048))]
    pub url: String,
    /// What it is told of.
    #[cfg_attr(feature = "server", schema(min_items = 1, max_items = 4))]
    pub events: Vec<WebhookEvent>,
    /// A name for people, at most 128 characters, none of them control characters.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(max_length = 128))]
    pub name: Option<String>,
}

/// What may be changed about a webhook; what is absent stays.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct WebhookChange {
    /// Where it is sent to.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(min_length = 1, max_length = 2048))]
    pub url: Option<String>,
    /// What it is told of.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(min_items = 1, max_items = 4))]
    pub events: Option<Vec<WebhookEvent>>,
    /// A name for people, at most 128 characters, none of them control characters.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(max_length = 128))]
    pub name: Option<String>,
    /// `false`: nothing is entered or sent any more. `true`: what waits is sent, also after the server switched it off.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub enabled: Option<bool>,
}

/// The field that is wrong with a list of events and a name, and what is wrong with it.
pub fn fault_of(events: Option<&[WebhookEvent]>, name: Option<&str>) -> Option<(&'static str, &'static str)> {
    let twice = |events: &[WebhookEvent]| (1..events.len()).any(|i| events[..i].contains(&events[i]));
    if events.is_some_and(|events| events.is_empty() || twice(events)) {
        return Some(("events", "must name at least one event, and each once"));
    }
    match name {
        Some(name) if name.chars().count() > 128 => Some(("name", "must have at most 128 characters")),
        Some(name) if has_control(name) => Some(("name", NO_CONTROL)),
        _ => None,
    }
}

/// A webhook, without its secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct WebhookView {
    /// Identifier.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub id: WebhookId,
    /// Where it is sent to.
    pub url: String,
    /// What it is told of.
    pub events: Vec<WebhookEvent>,
    /// A name for people.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub name: Option<String>,
    /// False when it was switched off, by somebody or by the server.
    pub enabled: bool,
    /// The key that made it. It stays when that key ends.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(value_type = Option<String>))]
    pub made_by: Option<KeyId>,
    /// RFC 3339.
    pub created_at: String,
    /// RFC 3339; since when nothing could be delivered, if the last attempt failed.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub failing_since: Option<String>,
    /// RFC 3339; when the server switched it off.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub switched_off_at: Option<String>,
    /// Why the server switched it off.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub switched_off_because: Option<String>,
}

/// A webhook that was just made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct CreatedWebhook {
    /// The webhook as lists show it.
    #[serde(flatten)]
    pub webhook: WebhookView,
    /// What signs its deliveries, `whsec_...`; shown this once.
    pub secret: String,
}

/// Where a delivery stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(
    feature = "server",
    derive(utoipa::ToSchema, sqlx::Type),
    sqlx(type_name = "text", rename_all = "snake_case")
)]
pub enum DeliveryState {
    /// It will be tried, for the first time or again.
    Pending,
    /// It was answered with a status of 200 to 299.
    Delivered,
    /// It was given up.
    Failed,
}

/// A message to a webhook.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct DeliveryView {
    /// Identifier; the header `webhook-id` of each attempt, replays included.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub id: DeliveryId,
    /// What it tells of.
    #[serde(rename = "type")]
    pub event: WebhookEvent,
    /// The job that it tells of.
    #[cfg_attr(feature = "server", schema(value_type = String))]
    pub job: JobId,
    /// Where it stands.
    pub state: DeliveryState,
    /// RFC 3339.
    pub created_at: String,
    /// RFC 3339; when it is tried next.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub next_attempt_at: Option<String>,
    /// What was tried, oldest first; the last 20.
    pub attempts: Vec<AttemptView>,
}

/// An attempt to deliver.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct AttemptView {
    /// RFC 3339.
    pub at: String,
    /// The status of the answer, if there was one.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub status: Option<u16>,
    /// Why it failed.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub error: Option<String>,
}

/// What a webhook is sent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct WebhookMessage {
    /// What it tells of.
    #[serde(rename = "type")]
    pub event: WebhookEvent,
    /// RFC 3339; when it happened.
    pub timestamp: String,
    /// What happened.
    pub data: WebhookData,
}

/// What happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct WebhookData {
    /// The job as it was when it ended.
    pub job: JobView,
}
