//! Exports: files that the server makes of models in the background.

use std::path::Path;
use std::time::Duration;

use reqwest::Method;
use tokio_util::bytes::Bytes;

use crate::connection::{Client, checked, json};
use crate::download::Download;
use crate::error::Result;
use relume_api::exports::{ExportView, NewExport};
use relume_api::{ExportId, List, ModelId};

/// Time between two looks at an export that is waited for.
const POLL_INTERVAL: Duration = Duration::from_millis(500);

impl Client {
    /// Queues an export of a model; the same key with the same export queues one.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
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
    /// The server's refusal, or what failed on the way.
    pub async fn export(&self, id: &ExportId) -> Result<ExportView> {
        json(self.request(Method::GET, &format!("/v1/exports/{id}"))?).await
    }

    /// The newest exports, of one model or of all.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn exports(&self, model: Option<&ModelId>) -> Result<List<ExportView>> {
        let query = model.map_or_else(String::new, |model| format!("?model={model}"));
        json(self.request(Method::GET, &format!("/v1/exports{query}"))?).await
    }

    /// Waits until an export has ended, however it does; `on_progress` is told each time the server was asked.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
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

    /// The file of an export, in memory.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn export_file(&self, id: &ExportId) -> Result<Bytes> {
        Download::begin(self.request(Method::GET, &format!("/v1/exports/{id}/file"))?).await?.whole().await
    }

    /// Downloads the file of an export to `path`.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way; an incomplete file may then be at `path`.
    pub async fn download_export(&self, id: &ExportId, path: &Path) -> Result<()> {
        let request = self.request(Method::GET, &format!("/v1/exports/{id}/file"))?;
        Download::begin(request).await?.save(path).await
    }

    /// Cancels an export that waits or runs; deletes one that has ended.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn delete_export(&self, id: &ExportId) -> Result<()> {
        checked(self.request(Method::DELETE, &format!("/v1/exports/{id}"))?).await.map(drop)
    }
}
