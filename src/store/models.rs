//! Published models.

use std::collections::HashSet;

use crate::store::metadata::{filtered, listed};
use crate::store::{Filter, ModelFile, ModelRecord, Page, Store, StoreError, sql};
use relume_api::{ModelId, TenantId};

impl Store {
    /// A model of a tenant by identifier.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn model(&self, tenant: &TenantId, id: &ModelId) -> Result<Option<ModelRecord>, StoreError> {
        let query =
            sql::query_as("SELECT * FROM models WHERE id = $1 AND tenant = $2 AND deleted_ms IS NULL")
                .bind(id)
                .bind(tenant);
        Ok(query.fetch_optional(self.pool()).await?)
    }

    /// Models of a tenant that match the filter, newest first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn models(
        &self,
        tenant: &TenantId,
        filter: &Filter,
        page: &Page,
    ) -> Result<Vec<ModelRecord>, StoreError> {
        let query = listed!(
            "models",
            "AND tenant = $6 AND deleted_ms IS NULL
               AND ($4 IS NULL OR (created_ms, id) < ($7, $4))
             ORDER BY created_ms DESC, id DESC LIMIT $5"
        );
        let query =
            filtered(query, filter).bind(page.id()).bind(i64::from(page.limit)).bind(tenant).bind(page.at());
        Ok(query.fetch_all(self.pool()).await?)
    }

    /// The identifiers of all resources that can have thumbnails: models and captures of all tenants.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn ids_with_thumbnails(&self) -> Result<HashSet<String>, StoreError> {
        let query = sql::query_scalar(
            "SELECT id FROM models WHERE deleted_ms IS NULL
             UNION SELECT id FROM captures WHERE deleted_ms IS NULL",
        );
        let ids: Vec<String> = query.fetch_all(self.pool()).await?;
        Ok(ids.into_iter().collect())
    }

    /// The files of a model, by name.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn model_files(&self, tenant: &TenantId, id: &ModelId) -> Result<Vec<ModelFile>, StoreError> {
        let query = sql::query_as(
            "SELECT model_files.* FROM model_files JOIN models ON models.id = model_id
             WHERE model_id = $1 AND tenant = $2 AND deleted_ms IS NULL ORDER BY model_files.name",
        );
        Ok(query.bind(id).bind(tenant).fetch_all(self.pool()).await?)
    }

    /// One file of a model, after its hash is verified; `None` if the file does not exist or the model was deleted in the
    /// meantime.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] or [`StoreError::Missing`] if the file is damaged or missing. When the database fails.
    pub async fn verified_model_file(
        &self,
        tenant: &TenantId,
        id: &ModelId,
        name: &str,
    ) -> Result<Option<ModelFile>, StoreError> {
        let Some(file) = self.model_file(tenant, id, name).await? else { return Ok(None) };
        match self.artifacts.verify(&file.artifact, &file.sha256).await {
            Err(StoreError::Missing(_)) if self.model(tenant, id).await?.is_none() => Ok(None),
            sound => sound.map(|()| Some(file)),
        }
    }

    /// One file of a model.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn model_file(
        &self,
        tenant: &TenantId,
        id: &ModelId,
        name: &str,
    ) -> Result<Option<ModelFile>, StoreError> {
        let query = sql::query_as(
            "SELECT model_files.* FROM model_files JOIN models ON models.id = model_id
             WHERE model_id = $1 AND model_files.name = $2 AND tenant = $3 AND deleted_ms IS NULL",
        );
        Ok(query.bind(id).bind(name).bind(tenant).fetch_optional(self.pool()).await?)
    }
}
