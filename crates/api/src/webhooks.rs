//! Webhooks: notifications of job events, according to [Standard Webhooks](https://www.standardwebhooks.com).

use serde::{Deserialize, Serialize};

use crate::jobs::{JobState, JobView};
use crate::metadata::{NO_CONTROL, has_control};
use crate::{DeliveryId, JobId, KeyId, WebhookId};

/// Event of a webhook.
///
/// `job.succeeded`: a job published a model. `job.rejected`: a job published a model that misses its quality
/// gate. `job.failed`: a job failed. `job.cancelled`: a caller cancelled a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[cfg_attr(feature = "sqlx", derive(sqlx::Type), sqlx(type_name = "text"))]
pub enum WebhookEvent {
    /// A job published a model.
    #[serde(rename = "job.succeeded")]
    #[cfg_attr(feature = "sqlx", sqlx(rename = "job.succeeded"))]
    JobSucceeded,
    /// A job published a model that misses its quality gate.
    #[serde(rename = "job.rejected")]
    #[cfg_attr(feature = "sqlx", sqlx(rename = "job.rejected"))]
    JobRejected,
    /// A job failed.
    #[serde(rename = "job.failed")]
    #[cfg_attr(feature = "sqlx", sqlx(rename = "job.failed"))]
    JobFailed,
    /// A caller cancelled a job.
    #[serde(rename = "job.cancelled")]
    #[cfg_attr(feature = "sqlx", sqlx(rename = "job.cancelled"))]
    JobCancelled,
}

impl WebhookEvent {
    /// The event of a final job state. `None` for other states.
    pub fn of(state: JobState) -> Option<Self> {
        match state {
            JobState::Queued | JobState::Running | JobState::Cancelling => None,
            JobState::Succeeded => Some(Self::JobSucceeded),
            JobState::Rejected => Some(Self::JobRejected),
            JobState::Failed => Some(Self::JobFailed),
            JobState::Cancelled => Some(Self::JobCancelled),
        }
    }

    /// Name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::JobSucceeded => "job.succeeded",
            Self::JobRejected => "job.rejected",
            Self::JobFailed => "job.failed",
            Self::JobCancelled => "job.cancelled",
        }
    }
}

/// A webhook to create.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewWebhook {
    /// Target URL, `https://...`, at most 2048 characters. The host must have a public address. The operator
    /// can allow `http://` and private addresses.
    #[schema(min_length = 1, max_length = 2048)]
    pub url: String,
    /// Events to send, each at most once.
    #[schema(min_items = 1, max_items = 4)]
    pub events: Vec<WebhookEvent>,
    /// Display name, at most 128 characters without control characters.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(max_length = 128)]
    pub name: Option<String>,
}

/// A change of a webhook. Omitted fields are unchanged.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WebhookChange {
    /// Target URL.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(min_length = 1, max_length = 2048)]
    pub url: Option<String>,
    /// Events to send, each at most once.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(min_items = 1, max_items = 4)]
    pub events: Option<Vec<WebhookEvent>>,
    /// Display name, at most 128 characters without control characters.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(max_length = 128)]
    pub name: Option<String>,
    /// `false`: the server neither queues nor sends messages. `true`: the server sends queued messages, also
    /// after it disabled the webhook itself.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub enabled: Option<bool>,
}

/// The first invalid field of a list of events and a name, and the reason.
pub fn validate_webhook(
    events: Option<&[WebhookEvent]>,
    name: Option<&str>,
) -> Option<(&'static str, &'static str)> {
    let twice = |events: &[WebhookEvent]| (1..events.len()).any(|i| events[..i].contains(&events[i]));
    if events.is_some_and(|events| events.is_empty() || twice(events)) {
        return Some(("events", "must contain at least one event, each at most once"));
    }
    match name {
        Some(name) if name.chars().count() > 128 => Some(("name", "must have at most 128 characters")),
        Some(name) if has_control(name) => Some(("name", NO_CONTROL)),
        _ => None,
    }
}

/// A webhook without its secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct WebhookView {
    /// Identifier.
    #[schema(value_type = String)]
    pub id: WebhookId,
    /// Target URL.
    pub url: String,
    /// Events to send, each at most once.
    pub events: Vec<WebhookEvent>,
    /// Display name.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub name: Option<String>,
    /// False if a caller or the server disabled the webhook.
    pub enabled: bool,
    /// Identifier of the key that created the webhook. The webhook remains when that key expires or is
    /// revoked.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>)]
    pub made_by: Option<KeyId>,
    /// Creation time, RFC 3339.
    pub created_at: String,
    /// Start of the current series of failed attempts, RFC 3339. Absent if the last attempt succeeded.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub failing_since: Option<String>,
    /// Time when the server disabled the webhook, RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub switched_off_at: Option<String>,
    /// Reason why the server disabled the webhook.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub switched_off_because: Option<String>,
}

/// A webhook with a new secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CreatedWebhook {
    /// The webhook without its secret.
    #[serde(flatten)]
    pub webhook: WebhookView,
    /// Secret that signs the deliveries, `whsec_...`. The server shows it once.
    pub secret: String,
}

/// State of a delivery.
///
/// `pending`: an attempt will follow. `delivered`: the receiver answered with a status of 200 to 299.
/// `failed`: the server stopped trying.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[derive(utoipa::ToSchema)]
#[cfg_attr(feature = "sqlx", derive(sqlx::Type), sqlx(type_name = "text", rename_all = "snake_case"))]
pub enum DeliveryState {
    /// A first or further attempt will follow.
    Pending,
    /// The receiver answered with a status of 200 to 299.
    Delivered,
    /// The server stopped trying.
    Failed,
}

/// A delivery to a webhook.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct DeliveryView {
    /// Identifier. Each attempt, including replays, sends it in the header `webhook-id`.
    #[schema(value_type = String)]
    pub id: DeliveryId,
    /// Event.
    #[serde(rename = "type")]
    pub event: WebhookEvent,
    /// Identifier of the job.
    #[schema(value_type = String)]
    pub job: JobId,
    /// State.
    pub state: DeliveryState,
    /// Creation time, RFC 3339.
    pub created_at: String,
    /// Time of the next attempt, RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub next_attempt_at: Option<String>,
    /// The last 20 attempts, oldest first.
    pub attempts: Vec<AttemptView>,
}

/// An attempt of a delivery.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct AttemptView {
    /// Time of the attempt, RFC 3339.
    pub at: String,
    /// HTTP status of the answer, if there was an answer.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub status: Option<u16>,
    /// Reason of the failure.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub error: Option<String>,
}

/// Body of a webhook message.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct WebhookMessage {
    /// Event.
    #[serde(rename = "type")]
    pub event: WebhookEvent,
    /// Time of the event, RFC 3339.
    pub timestamp: String,
    /// Data of the event.
    pub data: WebhookData,
}

/// Data of a webhook event.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct WebhookData {
    /// The job in its final state.
    pub job: JobView,
}
