//! Sends due messages: one at a time to each webhook, and concurrently to several webhooks.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::task::{Id, JoinSet};
use tokio_util::sync::CancellationToken;

use crate::jobs::Jobs;
use crate::server::outbound::Tls;
use crate::server::webhooks::policy::WebhookPolicy;
use crate::server::webhooks::schedule::retry_delay;
use crate::server::webhooks::sending::{DeliveryOutcome, Message, send};
use crate::server::webhooks::signature::sign;
use crate::store::{DeliveryAttempt, DeliveryRecord, StoreError};
use relume_api::WebhookId;

/// Time between two queries for due messages.
const POLL: Duration = Duration::from_millis(500);
/// Maximum number of webhooks that are sent to concurrently.
const MAX_CONCURRENT_WEBHOOKS: usize = 32;
/// Delay between two attempts to record a result, e.g. on a full disk.
const RECORD_RETRY_INTERVAL: Duration = Duration::from_secs(10);
/// Interval of the deletion of old messages, milliseconds.
const PRUNE_INTERVAL_MS: i64 = 3_600_000;

/// Sends messages until it is stopped. A message whose delivery is not recorded is sent again by the next server.
#[derive(Clone)]
pub(in crate::server) struct WebhookDispatcher {
    jobs: Jobs,
    policy: WebhookPolicy,
    tls: Arc<Tls>,
}

impl WebhookDispatcher {
    pub(in crate::server) fn new(jobs: Jobs, policy: WebhookPolicy) -> Self {
        Self { jobs, policy, tls: Arc::default() }
    }

    /// Runs until `stop` is cancelled, which also aborts messages in progress.
    pub(in crate::server) async fn run(self, stop: CancellationToken) {
        let mut under_way = JoinSet::new();
        let mut busy: HashMap<Id, WebhookId> = HashMap::new();
        let mut forgot_ms = i64::MIN;
        loop {
            let due = self.due_deliveries(&mut forgot_ms).await.unwrap_or_else(|error| {
                tracing::error!(%error, "cannot read the due messages of webhooks");
                Vec::new()
            });
            for delivery in due {
                if busy.len() < MAX_CONCURRENT_WEBHOOKS && !busy.values().any(|id| *id == delivery.webhook_id)
                {
                    let webhook = delivery.webhook_id.clone();
                    let task = under_way.spawn(self.clone().deliver(delivery));
                    busy.insert(task.id(), webhook);
                }
            }
            tokio::select! {
                () = stop.cancelled() => break,
                () = tokio::time::sleep(POLL) => {}
                Some(ended) = under_way.join_next_with_id() => {
                    let id = ended.map_or_else(|error| error.id(), |(id, ())| id);
                    busy.remove(&id);
                }
            }
        }
        under_way.shutdown().await;
    }

    /// The due messages. Periodically deletes old messages.
    async fn due_deliveries(&self, forgot_ms: &mut i64) -> Result<Vec<DeliveryRecord>, StoreError> {
        let (store, now_ms) = (self.jobs.store(), self.jobs.now_ms());
        if now_ms.saturating_sub(*forgot_ms) >= PRUNE_INTERVAL_MS {
            *forgot_ms = now_ms;
            store.delete_old_deliveries(now_ms).await?;
        }
        store.due_deliveries(now_ms).await
    }

    /// Sends a message and records the result. Retries the recording, because the message would otherwise be sent again.
    async fn deliver(self, delivery: DeliveryRecord) {
        let (webhook, id) = (delivery.webhook_id.clone(), delivery.id.clone());
        let Some(DeliveryOutcome { status, error }) = self.try_once(&delivery).await else { return };
        let now_ms = self.jobs.now_ms();
        let retry_delay = retry_delay(&id, delivery.tries.saturating_add(1));
        let retry_at_ms = retry_delay.map(|retry_delay| {
            now_ms.saturating_add(i64::try_from(retry_delay.as_millis()).unwrap_or(i64::MAX))
        });
        let outcome = if error.is_none() { "delivered" } else { "failed" };
        metrics::counter!("relume_webhook_attempts_total", "outcome" => outcome).increment(1);
        tracing::info!(%webhook, delivery = %id, status, error, "attempted a webhook delivery");
        let attempt = DeliveryAttempt { at_ms: now_ms, status, error };
        while let Err(error) = self.jobs.store().record_attempt(&delivery, attempt.clone(), retry_at_ms).await
        {
            tracing::error!(%error, %webhook, delivery = %id, "cannot record the result of a webhook delivery");
            tokio::time::sleep(RECORD_RETRY_INTERVAL).await;
        }
    }

    /// One attempt; `None` if the webhook no longer exists or is disabled.
    async fn try_once(&self, delivery: &DeliveryRecord) -> Option<DeliveryOutcome> {
        let webhook = match self.jobs.store().active_webhook(&delivery.webhook_id).await {
            Ok(webhook) => webhook?,
            Err(error) => {
                tracing::error!(%error, "cannot read a webhook");
                return None;
            }
        };
        let (id, now_ms) = (delivery.id.to_string(), self.jobs.now_ms());
        let seconds = now_ms / 1000;
        let signature = sign(webhook.secrets(now_ms), &id, seconds, &delivery.payload)?;
        let message = Message { id, seconds, signature, body: delivery.payload.clone() };
        Some(send(&webhook.url, message, &self.policy, &self.tls).await)
    }
}
