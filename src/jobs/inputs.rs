//! The inputs of an attempt: the capture, a known light, the last checkpoint.

use std::path::PathBuf;

use crate::jobs::lease::Lease;
use crate::store::StoreError;
use relume_api::EnvironmentId;

/// A stored file that an attempt may read.
#[derive(Debug, Clone)]
pub struct InputFile {
    /// Key in the artifact store.
    pub artifact: String,
    /// Hash of the bytes, lower-case hex; empty for a checkpoint of a version that did not store hashes.
    pub sha256: String,
}

impl Lease {
    /// The capture; `None` if it was deleted.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn capture(&self) -> Result<Option<InputFile>, StoreError> {
        let job = self.job();
        let record = self.jobs().store().capture(&job.tenant, &job.request.capture).await?;
        Ok(record.map(|record| InputFile { artifact: record.artifact, sha256: record.sha256 }))
    }

    /// An environment map of the job's tenant; `None` if it does not exist.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn environment(&self, id: &EnvironmentId) -> Result<Option<InputFile>, StoreError> {
        let record = self.jobs().store().environment(&self.job().tenant, id).await?;
        Ok(record.map(|record| InputFile { artifact: record.artifact, sha256: record.sha256 }))
    }

    /// The checkpoint at the time of the claim; `None` if there is none.
    pub fn last_checkpoint(&self) -> Option<InputFile> {
        let job = self.job();
        let sha256 = job.checkpoint_sha256.clone().unwrap_or_default();
        job.checkpoint.clone().map(|artifact| InputFile { artifact, sha256 })
    }

    /// Downloads a file if there is no local copy, and verifies its hash. Returns its path.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] or [`StoreError::Missing`] if the file is damaged or missing.
    pub async fn bring(&self, file: &InputFile) -> Result<PathBuf, StoreError> {
        let artifacts = self.jobs().store().artifacts();
        if !file.sha256.is_empty() {
            artifacts.verify(&file.artifact, &file.sha256).await?;
        }
        Ok(artifacts.local_path(&file.artifact))
    }
}
