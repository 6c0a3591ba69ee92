//! Exports: files that the server creates from models in the background.

use std::path::Path;
use std::time::Duration;

use reqwest::Method;
use tokio_util::bytes::Bytes;

use crate::connection::{Client, checked, json};
use crate::download::Download;
use crate::error::Result;
use relume_api::exports::{ExportView, NewExport};
use relume_api::{ExportId, List, ModelId};

/// Interval between polls of an export.
const POLL_INTERVAL: Duration = Duration::from_millis(500);

impl Client {
    /// Queues an export of a model. Repeating the request with the same idempotency key queues it only once.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn create_export(
        &self,
        model: &ModelId,
        export: &NewExport,
        idempotency_key: Option<&str>,
    ) -> Result<ExportView> {
        let request = self.request(Method::POST, &format!("/v1/models/{model}/exports"))?.json(export);
        json(match idempotency_key {
            Some(key) => request.header("idempotency-key", key),
            None => request,
        })
        .await
    }

    /// An export.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn export(&self, id: &ExportId) -> Result<ExportView> {
        json(self.request(Method::GET, &format!("/v1/exports/{id}"))?).await
    }

    /// The newest exports, of one model or of all.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn exports(&self, model: Option<&ModelId>) -> Result<List<ExportView>> {
        let query = model.map_or_else(String::new, |model| format!("?model={model}"));
        json(self.request(Method::GET, &format!("/v1/exports{query}"))?).await
    }

    /// Waits until an export has succeeded, failed or been cancelled; `on_progress` is called after each poll.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn wait_for_export(
        &self,
        id: &ExportId,
        mut on_progress: impl FnMut(&ExportView),
    ) -> Result<ExportView> {
        loop {
            let export = self.export(id).await?;
            on_progress(&export);
            if export.state.is_terminal() {
                return Ok(export);
            }
            tokio::time::sleep(POLL_INTERVAL).await;
        }
    }

    /// The file of an export in memory.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn export_file(&self, id: &ExportId) -> Result<Bytes> {
        Download::begin(self.request(Method::GET, &format!("/v1/exports/{id}/file"))?).await?.whole().await
    }

    /// Downloads the file of an export to `path`.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed; an incomplete file may remain at `path`.
    pub async fn download_export(&self, id: &ExportId, path: &Path) -> Result<()> {
        let request = self.request(Method::GET, &format!("/v1/exports/{id}/file"))?;
        Download::begin(request).await?.save(path).await
    }

    /// Cancels a queued or running export; deletes a completed one.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn delete_export(&self, id: &ExportId) -> Result<()> {
        checked(self.request(Method::DELETE, &format!("/v1/exports/{id}"))?).await.map(drop)
    }
}
