//! Enforces the quotas of tenants.

use crate::store::sql::{self, Tx};
use crate::store::usage::Allowance;
use crate::store::{Quota, Store, StoreError};
use relume_api::TenantId;

impl Store {
    /// Sets the quota of each tenant.
    #[must_use]
    pub fn with_quota(mut self, quota: Quota) -> Self {
        self.quota = quota;
        self
    }

    /// Refuses `asked` more bytes beyond the tenant's quota, which includes pending uploads. If the quota is already reached,
    /// refuses any further bytes.
    ///
    /// # Errors
    /// [`StoreError::ByteQuotaExceeded`], with the numbers.
    pub async fn admit_bytes_of(&self, tenant: &TenantId, asked: u64) -> Result<(), StoreError> {
        self.quota_allowance(tenant).await?.admit(asked.max(1))
    }

    /// The byte quota of a tenant and its stored bytes, including pending uploads.
    pub(super) async fn quota_allowance(&self, tenant: &TenantId) -> Result<Allowance, StoreError> {
        let Some(limit) = self.quota.bytes else {
            return Ok(Allowance { limit: u64::MAX, taken: 0, of_tenant: true });
        };
        let taken: i64 = sql::query_scalar(BYTES).bind(tenant).fetch_one(self.pool()).await?;
        let taken = u64::try_from(taken).unwrap_or(0).saturating_add(self.pending_quota.of(tenant));
        Ok(Allowance { limit, taken, of_tenant: true })
    }

    /// Refuses another job beyond the tenant's quota, in the transaction that queues the job.
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
