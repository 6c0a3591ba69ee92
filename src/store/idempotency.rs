//! Idempotency keys. A key is written in the transaction of the change it guards, so there is no moment at which
//! the key exists and the change does not: a second request waits for the first and then sees its answer.

use crate::store::sql::{self, Tx};
use crate::store::{Store, StoreError};
use relume_api::TenantId;

/// How long a key is remembered.
const KEEP_MS: i64 = 24 * 3600 * 1000;

/// A client's promise that two requests with this key are one.
#[derive(Debug, Clone)]
pub struct IdempotencyKey {
    /// The key.
    pub key: String,
    /// Hash of the request it came with.
    pub fingerprint: String,
}

/// The answer that `key` of a tenant was given before.
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

/// The answer of the `known` fingerprint and response of a key.
fn answer(known: Option<(String, String)>, key: &IdempotencyKey) -> Result<Option<String>, StoreError> {
    match known {
        Some((fingerprint, _)) if fingerprint != key.fingerprint => Err(StoreError::IdempotencyKeyReused),
        known => Ok(known.map(|(_, response)| response)),
    }
}

impl Store {
    /// The answer that `key` of a tenant was given before.
    ///
    /// # Errors
    /// [`StoreError::IdempotencyKeyReused`] when it came with another request.
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

/// Remembers the answer to `key`.
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
