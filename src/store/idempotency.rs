//! Idempotency keys. A key is written in the transaction of the change that it guards, so that a key never exists without its
//! change: a second request waits for the first and then gets the same answer.

use crate::store::sql::{self, Tx};
use crate::store::{Store, StoreError};
use relume_api::TenantId;

/// Time for which a key is remembered, milliseconds.
const KEEP_MS: i64 = 24 * 3600 * 1000;

/// An idempotency key of a client.
#[derive(Debug, Clone)]
pub struct IdempotencyKey {
    /// The key.
    pub key: String,
    /// Hash of the request.
    pub fingerprint: String,
}

/// The recorded answer to `key` of a tenant, if any. Deletes expired keys.
pub(super) async fn replay(
    tx: &mut Tx,
    tenant: &TenantId,
    key: &IdempotencyKey,
    now_ms: i64,
) -> Result<Option<String>, StoreError> {
    sql::query("DELETE FROM idempotency WHERE created_ms < $1")
        .bind(now_ms - KEEP_MS)
        .execute(&mut *tx)
        .await?;
    let known: Option<(String, String)> =
        sql::query_as("SELECT fingerprint, response FROM idempotency WHERE key = $1 AND tenant = $2")
            .bind(&key.key)
            .bind(tenant)
            .fetch_optional(&mut *tx)
            .await?;
    answer(known, key)
}

/// The answer from the `known` fingerprint and response of a key.
fn answer(known: Option<(String, String)>, key: &IdempotencyKey) -> Result<Option<String>, StoreError> {
    match known {
        Some((fingerprint, _)) if fingerprint != key.fingerprint => Err(StoreError::IdempotencyKeyReused),
        known => Ok(known.map(|(_, response)| response)),
    }
}

impl Store {
    /// The recorded answer to `key` of a tenant, if any.
    ///
    /// # Errors
    /// [`StoreError::IdempotencyKeyReused`] if the key was used with another request.
    pub async fn replayed(
        &self,
        tenant: &TenantId,
        key: &IdempotencyKey,
        now_ms: i64,
    ) -> Result<Option<String>, StoreError> {
        let query = "SELECT fingerprint, response FROM idempotency
                         WHERE key = $1 AND tenant = $2 AND created_ms >= $3";
        let known: Option<(String, String)> = sql::query_as(query)
            .bind(&key.key)
            .bind(tenant)
            .bind(now_ms - KEEP_MS)
            .fetch_optional(self.pool())
            .await?;
        answer(known, key)
    }
}

/// Records the answer to `key`.
pub(super) async fn remember(
    tx: &mut Tx,
    tenant: &TenantId,
    key: &IdempotencyKey,
    response: &str,
    now_ms: i64,
) -> Result<(), StoreError> {
    let query = sql::query(
        "INSERT INTO idempotency (key, fingerprint, response, created_ms, tenant) VALUES ($1, $2, $3, $4, $5)",
    );
    query
        .bind(&key.key)
        .bind(&key.fingerprint)
        .bind(response)
        .bind(now_ms)
        .bind(tenant)
        .execute(&mut *tx)
        .await?;
    Ok(())
}
