//! Finalises a resumable upload: links its bytes under another name, so that the upload itself is kept until a capture is
//! published.

use std::fs::File;

use object_store::path::Path as Key;

use crate::store::hash::hash_file;
use crate::store::staged_upload::INCOMING;
use crate::store::uploads::record::UploadRecord;
use crate::store::uploads::upload_locks::UploadLock;
use crate::store::{StagedUpload, Store, StoreError};

impl Store {
    /// Hashes the bytes of a complete upload and links them under the fresh name `name`. The upload is removed when they are
    /// published, and kept when they are dropped.
    ///
    /// # Errors
    /// When the file system fails.
    pub async fn finalise_upload(
        &self,
        lock: UploadLock,
        upload: &UploadRecord,
        name: &str,
    ) -> Result<StagedUpload, StoreError> {
        let key = Key::from(format!("{INCOMING}/{name}"));
        let (from, path) =
            (self.artifacts.local_path(&upload.key()), self.artifacts.local_path(key.as_ref()));
        let to = path.clone();
        let hashed = tokio::task::spawn_blocking(move || {
            let sha256 = hash_file(&mut File::open(&from)?)?;
            to.parent().map_or(Ok(()), std::fs::create_dir_all)?;
            std::fs::hard_link(&from, &to)?;
            Ok::<_, std::io::Error>(sha256)
        });
        let sha256 = hashed.await.map_err(std::io::Error::other)??;
        // The bytes are counted with the upload.
        let reserved = self.reservation(&upload.tenant);
        let bytes = upload.total();
        Ok(StagedUpload { key, published: false, path, sha256, bytes, upload: Some(lock), reserved })
    }
}
