//! Refuses what a tenant would have beyond its quota.

use crate::store::sql::{self, Tx};
use crate::store::usage::Allowance;
use crate::store::{Quota, Store, StoreError};
use relume_api::TenantId;

impl Store {
    /// Bounds what each tenant may have.
    #[must_use]
    pub fn with_quota(mut self, quota: Quota) -> Self {
        self.quota = quota;
        self
    }

    /// Refuses `asked` more bytes of a tenant beyond its quota, uploads in progress included; any more at all when it is reached.
    ///
    /// # Errors
    /// [`StoreError::ByteQuotaExceeded`] with the numbers.
    pub async fn admit_bytes_of(&self, tenant: &TenantId, asked: u64) -> Result<(), StoreError> {
        self.quota_allowance(tenant).await?.admit(asked.max(1))
    }

    /// What a tenant may store and what it does, uploads in progress included.
    pub(super) async fn quota_allowance(&self, tenant: &TenantId) -> Result<Allowance, StoreError> {
        let Some(limit) = self.quota.bytes else {
            return Ok(Allowance { limit: u64::MAX, taken: 0, of_tenant: true });
        };
        let taken: i64 = sql::query_scalar(BYTES).bind(tenant).fetch_one(self.pool()).await?;
        let taken = u64::try_from(taken).unwrap_or(0).saturating_add(self.pending_quota.of(tenant));
        Ok(Allowance { limit, taken, of_tenant: true })
    }

    /// Refuses one more job of a tenant beyond its quota, in the transaction that would queue it.
    pub(super) async fn admit_job_of(&self, tx: &mut Tx, tenant: &TenantId) -> Result<(), StoreError> {
        let Some(most) = self.quota.jobs else { return Ok(()) };
        let active: i64 = sql::query_scalar(JOBS).bind(tenant).fetch_one(&mut *tx).await?;
        if active >= i64::from(most) { Err(StoreError::JobQuotaExceeded { most }) } else { Ok(()) }
    }
}

const BYTES: &str = "SELECT CAST(
        COALESCE((SELECT SUM(bytes) FROM captures WHERE tenant = $1 AND deleted_ms IS NULL), 0)
      + COALESCE((SELECT SUM(bytes) FROM environments WHERE tenant = $1 AND deleted_ms IS NULL), 0)
      + COALESCE((SELECT SUM(received) FROM uploads WHERE tenant = $1), 0)
      + COALESCE((SELECT SUM(bytes) FROM model_files JOIN models ON models.id = model_id
                  WHERE tenant = $1 AND deleted_ms IS NULL), 0)
      + COALESCE((SELECT SUM(COALESCE(bytes, 0) + work_bytes) FROM exports WHERE tenant = $1 AND deleted_ms IS NULL), 0) AS BIGINT)";

const JOBS: &str =
    "SELECT COUNT(*) FROM jobs WHERE tenant = $1 AND state IN ('queued', 'running', 'cancelling')";
