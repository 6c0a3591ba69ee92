//! Publication of a model: stores its files, then records the model in the transaction that ends its job.

use crate::jobs::lease::Lease;
use crate::store::{ModelFile, ModelRecord, StagedUpload, StoreError};
use relume_api::quality::Figures;
use relume_api::work::{FinishedModel, LeaseStatus, SentFile};

/// Media type of a model's files.
const CONTENT_TYPE: &str = "application/octet-stream";

impl Lease {
    /// Stores a file of the attempt's model.
    ///
    /// # Errors
    /// When the bytes cannot be stored.
    pub async fn put_file(&self, name: &str, bytes: Vec<u8>) -> Result<SentFile, StoreError> {
        let size = bytes.len() as u64;
        let stored = self.jobs().store().artifacts().put(&self.file_key(name), bytes).await;
        let sha256 = self.note_disk_shortage(stored, size)?;
        Ok(SentFile { name: name.to_owned(), sha256, bytes: size })
    }

    /// As [`Self::put_file`], for bytes that have already arrived.
    ///
    /// # Errors
    /// When the bytes cannot be stored.
    pub async fn take_file(&self, name: &str, bytes: StagedUpload) -> Result<SentFile, StoreError> {
        let file = SentFile { name: name.to_owned(), sha256: bytes.sha256.clone(), bytes: bytes.bytes };
        self.jobs().store().artifacts().publish(bytes, &self.file_key(name)).await?;
        Ok(file)
    }

    /// Verifies the hash of a stored file.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] or [`StoreError::Missing`].
    pub async fn verify_file(&self, file: &SentFile) -> Result<(), StoreError> {
        let (artifacts, key) = (self.jobs().store().artifacts(), self.file_key(&file.name));
        artifacts.verify(&key, &file.sha256).await?;
        let size = tokio::fs::metadata(artifacts.local_path(&key)).await?.len();
        if size == file.bytes { Ok(()) } else { Err(StoreError::Damaged(key)) }
    }

    /// Publishes the model with its stored files and ends the job. With any other result than [`LeaseStatus::Held`] nothing was
    /// published, and the files are removed.
    ///
    /// # Errors
    /// When the database fails. The model may be published nevertheless, unless the disk was full.
    pub async fn finish(&self, model: FinishedModel) -> Result<LeaseStatus, StoreError> {
        let mut figures = model.figures;
        figures.warnings = self.jobs().store().warnings(&self.job().id).await?;
        let record = self.record(model.gaussians, model.card, &figures);
        let files: Vec<ModelFile> = model.files.iter().map(|file| self.model_file(file)).collect();
        let size = model.files.iter().map(|file| file.bytes).sum();
        let published = self.note_disk_shortage(self.publish(&record, &files, figures).await, size);
        let is_in_vain = match &published {
            Ok(status) => *status != LeaseStatus::Held,
            Err(error) => matches!(error, StoreError::Full),
        };
        if is_in_vain {
            self.discard(files.iter().map(|file| file.name.as_str())).await;
        }
        published
    }

    /// Removes files of an attempt that published nothing.
    pub async fn discard(&self, names: impl Iterator<Item = &str>) {
        for name in names {
            self.jobs().store().artifacts().remove(&self.file_key(name)).await;
        }
    }

    fn file_key(&self, name: &str) -> String {
        format!("{}/{name}", self.artifact_prefix())
    }

    fn model_file(&self, file: &SentFile) -> ModelFile {
        ModelFile {
            name: file.name.clone(),
            content_type: CONTENT_TYPE.to_owned(),
            bytes: i64::try_from(file.bytes).unwrap_or(i64::MAX),
            sha256: file.sha256.clone(),
            artifact: self.file_key(&file.name),
        }
    }

    fn record(&self, gaussians: i64, card: serde_json::Value, figures: &Figures) -> ModelRecord {
        let job = self.job();
        ModelRecord {
            id: self.jobs().fresh_id(),
            job_id: job.id.clone(),
            capture_id: job.request.capture.clone(),
            gaussians,
            // The store replaces these by the metadata of the job.
            metadata: job.request.metadata(),
            card: with_figures(card, figures),
            created_ms: self.jobs().now_ms(),
        }
    }
}

/// The model card with the figures. The file does not contain them, so that its bytes depend only on the job.
fn with_figures(mut card: serde_json::Value, figures: &Figures) -> serde_json::Value {
    if let Some(fields) = card.as_object_mut() {
        fields.insert("figures".to_owned(), serde_json::json!(figures));
    }
    card
}
