//! What webhooks are sent. A job's end enters its messages in the transaction that ends the job; a message leaves the queue
//! once its outcome is written down. A server that dies in between sends it again: at least once.

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

/// Attempts that are kept of a delivery.
const MAX_LOGGED_ATTEMPTS: usize = 20;
/// Deliveries that were entered this long ago are forgotten, whatever became of them.
const DELIVERY_RETENTION: Duration = Duration::from_secs(30 * 24 * 3600);
/// A webhook is switched off when nothing could be delivered for this long.
const DISABLE_AFTER: Duration = Duration::from_secs(3 * 24 * 3600);

/// A message to a webhook.
#[derive(Debug, Clone, FromRow)]
pub struct DeliveryRecord {
    /// Identifier.
    pub id: DeliveryId,
    /// Grows with every message of the server.
    pub seq: i64,
    /// Whom it is for.
    pub webhook_id: WebhookId,
    /// What it tells of.
    pub event: WebhookEvent,
    /// The job that it tells of.
    pub job_id: JobId,
    /// The bytes that are sent.
    pub payload: String,
    /// When it was entered.
    pub created_ms: i64,
    /// Where it stands.
    pub state: DeliveryState,
    /// When it is tried next, while it is pending.
    pub due_ms: i64,
    /// Attempts since it was entered or replayed.
    pub tries: i64,
    /// What was tried, oldest first.
    #[sqlx(json)]
    pub attempts: Vec<DeliveryAttempt>,
}

paginated!(DeliveryRecord: seq);

/// An attempt to deliver.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeliveryAttempt {
    /// When.
    pub at_ms: i64,
    /// The status of the answer, if there was one.
    pub status: Option<u16>,
    /// Why it failed.
    pub error: Option<String>,
}

impl DeliveryAttempt {
    /// 410 says that nobody will listen there again.
    fn is_gone(&self) -> bool {
        self.status == Some(410)
    }
}

/// Outcome of a request to send a message again.
#[derive(Debug)]
pub enum Replay {
    /// It is pending.
    Accepted(DeliveryRecord),
    /// Its webhook is switched off.
    SwitchedOff,
    /// There is no such message.
    NotFound,
}

/// A webhook that is on, and what it wants to hear of.
#[derive(FromRow)]
struct ActiveWebhook {
    id: WebhookId,
    #[sqlx(json)]
    events: Vec<WebhookEvent>,
}

/// Enters the messages about a job that has just ended, for the webhooks of its tenant that want them.
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
    /// The message that is due first, of each webhook that is on.
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

    /// A webhook of whichever tenant that is on: to send to it.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn active_webhook(&self, id: &WebhookId) -> Result<Option<WebhookRecord>, StoreError> {
        let query = sql::query_as("SELECT * FROM webhooks WHERE id = $1 AND enabled");
        Ok(query.bind(id).fetch_optional(self.pool()).await?)
    }

    /// Writes down what became of an attempt: delivered, to be tried again at `retry_at_ms`, or given up where that is none.
    /// A webhook that could not be reached for days, or is gone, is switched off.
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

    /// Makes a message to a webhook of a tenant due at once, however often it was tried.
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

    /// Forgets messages that were entered long ago.
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

/// Counts a failure against a webhook.
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
    tracing::warn!(%webhook, why, "switched a webhook off");
    let query = sql::query(
        "UPDATE webhooks SET enabled = FALSE, switched_off_ms = $2, switched_off_because = $3 WHERE id = $1",
    );
    query.bind(webhook).bind(attempt.at_ms).bind(why).execute(&mut *tx).await?;
    Ok(())
}

fn ms(duration: Duration) -> i64 {
    i64::try_from(duration.as_millis()).unwrap_or(i64::MAX)
}
