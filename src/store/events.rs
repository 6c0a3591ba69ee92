//! The history of a job. Events are numbered, so that a client can continue after the last one that it received.

use serde_json::Value;

use crate::store::sql::{self, Tx};
use crate::store::{EventRecord, Store, StoreError, deliveries};
use relume_api::jobs::JobState;
use relume_api::webhooks::WebhookEvent;
use relume_api::{JobId, TenantId};

impl Store {
    /// At most 1,000 events of a job of a tenant with numbers above `after`, oldest first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn events_after(
        &self,
        tenant: &TenantId,
        job: &JobId,
        after: i64,
    ) -> Result<Vec<EventRecord>, StoreError> {
        let query = sql::query_as(
            "SELECT * FROM events WHERE job_id = $1 AND seq > $2
               AND job_id IN (SELECT id FROM jobs WHERE id = $1 AND tenant = $3)
             ORDER BY seq LIMIT 1000",
        );
        Ok(query.bind(job).bind(after).bind(tenant).fetch_all(self.pool()).await?)
    }
}

/// Records a job's change of state in the transaction of the change: its event and, if the job has ended, its messages to
/// webhooks.
pub(super) async fn append_state(
    tx: &mut Tx,
    job: &JobId,
    now_ms: i64,
    state: JobState,
    data: Value,
) -> Result<(), StoreError> {
    append(tx, job, now_ms, "state", data).await?;
    match WebhookEvent::of(state) {
        Some(event) => deliveries::enqueue(tx, job, event, now_ms).await,
        None => Ok(()),
    }
}

/// Appends an event to a job's history, in the transaction of the change that it reports.
pub(super) async fn append(
    tx: &mut Tx,
    job: &JobId,
    now_ms: i64,
    kind: &str,
    data: Value,
) -> Result<(), StoreError> {
    sql::query("INSERT INTO events (job_id, at_ms, kind, data) VALUES ($1, $2, $3, $4)")
        .bind(job)
        .bind(now_ms)
        .bind(kind)
        .bind(data.to_string())
        .execute(&mut *tx)
        .await?;
    Ok(())
}
