//! Queue of messages to webhooks. The transaction that ends a job adds its messages. A message leaves the queue after its result
//! is recorded. If the server terminates in between, it sends the message again (at-least-once delivery).

use std::time::Duration;

use serde::{Deserialize, Serialize};
use sqlx::FromRow;
use sqlx::types::Json;

use crate::store::job_view::rfc3339;
use crate::store::page::paginated;
use crate::store::sql::{self, Tx};
use crate::store::{JobRecord, Page, Store, StoreError, WebhookRecord};
use relume_api::webhooks::{DeliveryState, WebhookData, WebhookEvent, WebhookMessage};
use relume_api::{DeliveryId, JobId, TenantId, WebhookId};

/// Number of recorded attempts of a delivery.
const MAX_LOGGED_ATTEMPTS: usize = 20;
/// Age at which deliveries are deleted, whatever their state.
const DELIVERY_RETENTION: Duration = Duration::from_secs(30 * 24 * 3600);
/// A webhook is disabled after failing for this long.
const DISABLE_AFTER: Duration = Duration::from_secs(3 * 24 * 3600);

/// A message to a webhook.
#[derive(Debug, Clone, FromRow)]
pub struct DeliveryRecord {
    /// Identifier.
    pub id: DeliveryId,
    /// Number in the order of all messages of the server.
    pub seq: i64,
    /// The webhook that receives the message.
    pub webhook_id: WebhookId,
    /// The type of event.
    pub event: WebhookEvent,
    /// The job of the event.
    pub job_id: JobId,
    /// The bytes of the message.
    pub payload: String,
    /// Time of creation.
    pub created_ms: i64,
    /// State of the delivery.
    pub state: DeliveryState,
    /// Time of the next attempt while it is pending.
    pub due_ms: i64,
    /// Attempts since the message was created or replayed.
    pub tries: i64,
    /// The last attempts, oldest first.
    #[sqlx(json)]
    pub attempts: Vec<DeliveryAttempt>,
}

paginated!(DeliveryRecord: seq);

/// An attempt to deliver a message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeliveryAttempt {
    /// Time of the attempt.
    pub at_ms: i64,
    /// The HTTP status of the answer, if any.
    pub status: Option<u16>,
    /// The reason of the failure.
    pub error: Option<String>,
}

impl DeliveryAttempt {
    /// Status 410 means that the receiver no longer exists.
    fn is_gone(&self) -> bool {
        self.status == Some(410)
    }
}

/// Result of a request to send a message again.
#[derive(Debug)]
pub enum Replay {
    /// The message is pending.
    Accepted(DeliveryRecord),
    /// The webhook is disabled.
    SwitchedOff,
    /// The message does not exist.
    NotFound,
}

/// An enabled webhook and its events.
#[derive(FromRow)]
struct ActiveWebhook {
    id: WebhookId,
    #[sqlx(json)]
    events: Vec<WebhookEvent>,
}

/// Adds the messages about a job that has just ended, for the webhooks of its tenant that subscribe to the event.
pub(super) async fn enqueue(
    tx: &mut Tx,
    job: &JobId,
    event: WebhookEvent,
    now_ms: i64,
) -> Result<(), StoreError> {
    let listening: Vec<ActiveWebhook> = sql::query_as(
        "SELECT webhooks.id, webhooks.events FROM webhooks JOIN jobs ON jobs.tenant = webhooks.tenant
         WHERE jobs.id = $1 AND enabled ORDER BY webhooks.created_ms, webhooks.id",
    )
    .bind(job)
    .fetch_all(&mut *tx)
    .await?;
    let wanted: Vec<_> = listening.into_iter().filter(|webhook| webhook.events.contains(&event)).collect();
    if wanted.is_empty() {
        return Ok(());
    }
    let ended: JobRecord =
        sql::query_as("SELECT * FROM jobs WHERE id = $1").bind(job).fetch_one(&mut *tx).await?;
    let data = WebhookData { job: ended.view(None) };
    let message = WebhookMessage { event, timestamp: rfc3339(now_ms), data };
    let payload = serde_json::to_string(&message).map_err(std::io::Error::other)?;
    for webhook in wanted {
        sql::query(
            "INSERT INTO deliveries (id, webhook_id, event, job_id, payload, created_ms, state, due_ms)
             VALUES ($6, $1, $2, $3, $4, $5, 'pending', $5)",
        )
        .bind(webhook.id)
        .bind(event)
        .bind(job)
        .bind(&payload)
        .bind(now_ms)
        .bind(format!("msg_{}", uuid::Uuid::now_v7().simple()))
        .execute(&mut *tx)
        .await?;
    }
    Ok(())
}

impl Store {
    /// The next due message of each enabled webhook.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn due_deliveries(&self, now_ms: i64) -> Result<Vec<DeliveryRecord>, StoreError> {
        let query = sql::query_as(
            "SELECT deliveries.* FROM webhooks JOIN deliveries ON deliveries.seq =
                 (SELECT seq FROM deliveries AS mine WHERE mine.webhook_id = webhooks.id AND mine.state = 'pending'
                      AND mine.due_ms <= $1 ORDER BY mine.due_ms, mine.seq LIMIT 1)
             WHERE webhooks.enabled ORDER BY deliveries.due_ms, deliveries.seq",
        );
        Ok(query.bind(now_ms).fetch_all(self.pool()).await?)
    }

    /// An enabled webhook of any tenant.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn active_webhook(&self, id: &WebhookId) -> Result<Option<WebhookRecord>, StoreError> {
        let query = sql::query_as("SELECT * FROM webhooks WHERE id = $1 AND enabled");
        Ok(query.bind(id).fetch_optional(self.pool()).await?)
    }

    /// Records the result of an attempt: delivered, to be retried at `retry_at_ms`, or failed if that is `None`. Disables a
    /// webhook that has failed for days or answers 410.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn record_attempt(
        &self,
        delivery: &DeliveryRecord,
        attempt: DeliveryAttempt,
        retry_at_ms: Option<i64>,
    ) -> Result<(), StoreError> {
        let mut tx = self.write().await?;
        let failed = attempt.error.is_some();
        let state = match retry_at_ms {
            _ if !failed => DeliveryState::Delivered,
            Some(_) if !attempt.is_gone() => DeliveryState::Pending,
            _ => DeliveryState::Failed,
        };
        let mut attempts = delivery.attempts.clone();
        attempts.push(attempt.clone());
        attempts.drain(..attempts.len().saturating_sub(MAX_LOGGED_ATTEMPTS));
        sql::query(
            "UPDATE deliveries SET state = $2, due_ms = $3, tries = tries + 1, attempts = $4 WHERE id = $1",
        )
        .bind(&delivery.id)
        .bind(state)
        .bind(retry_at_ms.unwrap_or(attempt.at_ms))
        .bind(Json(&attempts))
        .execute(&mut tx)
        .await?;
        if failed {
            record_failure(&mut tx, &delivery.webhook_id, &attempt).await?;
        } else {
            let query = sql::query("UPDATE webhooks SET failing_since_ms = NULL WHERE id = $1");
            query.bind(&delivery.webhook_id).execute(&mut tx).await?;
        }
        Ok(tx.commit().await?)
    }

    /// A message to a webhook of a tenant.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn delivery(
        &self,
        tenant: &TenantId,
        webhook: &WebhookId,
        id: &DeliveryId,
    ) -> Result<Option<DeliveryRecord>, StoreError> {
        let query = sql::query_as(
            "SELECT deliveries.* FROM deliveries JOIN webhooks ON webhooks.id = webhook_id
             WHERE deliveries.id = $1 AND webhook_id = $2 AND tenant = $3",
        );
        Ok(query.bind(id).bind(webhook).bind(tenant).fetch_optional(self.pool()).await?)
    }

    /// Messages to a webhook of a tenant, newest first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn deliveries(
        &self,
        tenant: &TenantId,
        webhook: &WebhookId,
        page: &Page,
    ) -> Result<Vec<DeliveryRecord>, StoreError> {
        let query = sql::query_as(
            "SELECT deliveries.* FROM deliveries JOIN webhooks ON webhooks.id = webhook_id
             WHERE webhook_id = $2 AND tenant = $3
               AND ($1 IS NULL OR seq < $1)
             ORDER BY seq DESC LIMIT $4",
        );
        let query = query.bind(page.at()).bind(webhook).bind(tenant).bind(i64::from(page.limit));
        Ok(query.fetch_all(self.pool()).await?)
    }

    /// Makes a message to a webhook of a tenant due immediately, independent of its number of attempts.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn replay_delivery(
        &self,
        tenant: &TenantId,
        webhook: &WebhookId,
        id: &DeliveryId,
        now_ms: i64,
    ) -> Result<Replay, StoreError> {
        let mut tx = self.write().await?;
        let query = sql::query_scalar("SELECT enabled FROM webhooks WHERE id = $1 AND tenant = $2");
        let enabled: Option<bool> = query.bind(webhook).bind(tenant).fetch_optional(&mut tx).await?;
        let query = sql::query_as(
            "UPDATE deliveries SET state = 'pending', due_ms = $3, tries = 0
             WHERE id = $1 AND webhook_id = $2 RETURNING *",
        );
        let replayed = query.bind(id).bind(webhook).bind(now_ms).fetch_optional(&mut tx).await?;
        match (enabled, replayed) {
            (None, _) | (_, None) => Ok(Replay::NotFound),
            (Some(false), _) => Ok(Replay::SwitchedOff),
            (Some(true), Some(replayed)) => {
                tx.commit().await?;
                Ok(Replay::Accepted(replayed))
            }
        }
    }

    /// Deletes old messages.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn delete_old_deliveries(&self, now_ms: i64) -> Result<(), StoreError> {
        let before = now_ms.saturating_sub(ms(DELIVERY_RETENTION));
        let old = sql::query_scalar("SELECT EXISTS (SELECT 1 FROM deliveries WHERE created_ms < $1)");
        if !old.bind(before).fetch_one(self.pool()).await? {
            return Ok(());
        }
        let mut tx = self.write().await?;
        let query = sql::query("DELETE FROM deliveries WHERE created_ms < $1");
        query.bind(before).execute(&mut tx).await?;
        Ok(tx.commit().await?)
    }
}

/// Records a failure of a webhook.
async fn record_failure(
    tx: &mut Tx,
    webhook: &WebhookId,
    attempt: &DeliveryAttempt,
) -> Result<(), StoreError> {
    let since: Option<i64> = sql::query_scalar(
        "UPDATE webhooks SET failing_since_ms = COALESCE(failing_since_ms, $2)
         WHERE id = $1 AND enabled RETURNING failing_since_ms",
    )
    .bind(webhook)
    .bind(attempt.at_ms)
    .fetch_optional(&mut *tx)
    .await?;
    let Some(since) = since else { return Ok(()) };
    let last = attempt.error.as_deref().unwrap_or_default();
    let why = if attempt.is_gone() {
        "the receiver answered 410 Gone".to_owned()
    } else if attempt.at_ms.saturating_sub(since) >= ms(DISABLE_AFTER) {
        format!("every delivery since {} failed; last error: {last}", rfc3339(since))
    } else {
        return Ok(());
    };
    tracing::warn!(%webhook, why, "disabled a webhook");
    let query = sql::query(
        "UPDATE webhooks SET enabled = FALSE, switched_off_ms = $2, switched_off_because = $3 WHERE id = $1",
    );
    query.bind(webhook).bind(attempt.at_ms).bind(why).execute(&mut *tx).await?;
    Ok(())
}

fn ms(duration: Duration) -> i64 {
    i64::try_from(duration.as_millis()).unwrap_or(i64::MAX)
}
