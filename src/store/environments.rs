//! Environment maps.

use sqlx::types::Json;

use crate::store::metadata::{change_metadata_in_tx, filtered, listed};
use crate::store::{EnvironmentRecord, Filter, Page, Store, StoreError, sql};
use relume_api::{EnvironmentId, ResourceKind, ResourceName, TenantId};

impl Store {
    /// Records an environment. If the tenant already has an environment with the same content, returns that one and changes its
    /// metadata to those of `environment`.
    ///
    /// # Errors
    /// [`StoreError::InvalidMetadata`] if the existing environment cannot have these metadata. When the database fails.
    pub async fn insert_environment(
        &self,
        tenant: &TenantId,
        env: &EnvironmentRecord,
    ) -> Result<EnvironmentRecord, StoreError> {
        let mut tx = self.write().await?;
        sql::query(
            "INSERT INTO environments
                 (id, sha256, name, bytes, artifact, width, height, warnings, created_ms, tenant, external_id, labels)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12) ON CONFLICT (tenant, sha256) DO NOTHING",
        )
        .bind(&env.id)
        .bind(&env.sha256)
        .bind(&env.metadata.name)
        .bind(env.bytes)
        .bind(&env.artifact)
        .bind(env.width)
        .bind(env.height)
        .bind(Json(&env.warnings))
        .bind(env.created_ms)
        .bind(tenant)
        .bind(&env.metadata.external_id)
        .bind(Json(&env.metadata.labels))
        .execute(&mut tx)
        .await?;
        let mut stored: EnvironmentRecord =
            sql::query_as("SELECT * FROM environments WHERE sha256 = $1 AND tenant = $2")
                .bind(&env.sha256)
                .bind(tenant)
                .fetch_one(&mut tx)
                .await?;
        if stored.id != env.id {
            let what = ResourceName::new(ResourceKind::Environment, stored.id.to_string());
            let change = env.metadata.clone().into();
            stored.metadata =
                change_metadata_in_tx(&mut tx, tenant, &what, &change).await?.unwrap_or(stored.metadata);
        }
        tx.commit().await?;
        Ok(stored)
    }

    /// An environment of a tenant by identifier.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn environment(
        &self,
        tenant: &TenantId,
        id: &EnvironmentId,
    ) -> Result<Option<EnvironmentRecord>, StoreError> {
        let query =
            sql::query_as("SELECT * FROM environments WHERE id = $1 AND tenant = $2 AND deleted_ms IS NULL")
                .bind(id)
                .bind(tenant);
        Ok(query.fetch_optional(self.pool()).await?)
    }

    /// An environment of a tenant by the hash of its content.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn environment_by_hash(
        &self,
        tenant: &TenantId,
        sha256: &str,
    ) -> Result<Option<EnvironmentRecord>, StoreError> {
        let query = sql::query_as("SELECT * FROM environments WHERE sha256 = $1 AND tenant = $2")
            .bind(sha256)
            .bind(tenant);
        Ok(query.fetch_optional(self.pool()).await?)
    }

    /// Environments of a tenant that match the filter, newest first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn environments(
        &self,
        tenant: &TenantId,
        filter: &Filter,
        page: &Page,
    ) -> Result<Vec<EnvironmentRecord>, StoreError> {
        let query = listed!(
            "environments",
            "AND tenant = $6 AND deleted_ms IS NULL
               AND ($4 IS NULL OR (created_ms, id) < ($7, $4))
             ORDER BY created_ms DESC, id DESC LIMIT $5"
        );
        let query =
            filtered(query, filter).bind(page.id()).bind(i64::from(page.limit)).bind(tenant).bind(page.at());
        Ok(query.fetch_all(self.pool()).await?)
    }
}
