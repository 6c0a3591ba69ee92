//! What an attempt reads: the capture, a known light, the last checkpoint.

use std::path::PathBuf;

use crate::api::EnvironmentId;
use crate::jobs::lease::Lease;
use crate::store::StoreError;

/// A stored file whose bytes were compared with their hash.
#[derive(Debug, Clone)]
pub struct StoredFile {
    /// Key in the artifact store.
    pub artifact: String,
    /// The file on this machine.
    pub path: PathBuf,
    /// Hash of the bytes, lower-case hex.
    pub sha256: String,
}

impl Lease {
    /// The capture; none when it was deleted.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] or [`StoreError::Missing`] when its bytes are not those that were stored.
    pub async fn capture(&self) -> Result<Option<StoredFile>, StoreError> {
        let job = self.job();
        match self.jobs().store().capture(&job.tenant, &job.request.capture).await? {
            Some(record) => self.sound(record.artifact, record.sha256).await.map(Some),
            None => Ok(None),
        }
    }

    /// An environment map of the job's tenant; none when there is none.
    ///
    /// # Errors
    /// As [`Self::capture`].
    pub async fn environment(&self, id: &EnvironmentId) -> Result<Option<StoredFile>, StoreError> {
        match self.jobs().store().environment(&self.job().tenant, id).await? {
            Some(record) => self.sound(record.artifact, record.sha256).await.map(Some),
            None => Ok(None),
        }
    }

    /// The checkpoint that the job was claimed with; none where there is none.
    ///
    /// # Errors
    /// As [`Self::capture`].
    pub async fn last_checkpoint(&self) -> Result<Option<StoredFile>, StoreError> {
        let job = self.job();
        match (&job.checkpoint, &job.checkpoint_sha256) {
            (Some(key), Some(sha256)) => self.sound(key.clone(), sha256.clone()).await.map(Some),
            (Some(key), None) => {
                let path = self.jobs().store().artifacts().local_path(key);
                Ok(Some(StoredFile { artifact: key.clone(), path, sha256: String::new() }))
            }
            (None, _) => Ok(None),
        }
    }

    async fn sound(&self, artifact: String, sha256: String) -> Result<StoredFile, StoreError> {
        let artifacts = self.jobs().store().artifacts();
        artifacts.verify(&artifact, &sha256).await?;
        let path = artifacts.local_path(&artifact);
        Ok(StoredFile { artifact, path, sha256 })
    }
}
