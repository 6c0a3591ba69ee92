//! Stored bytes and storage limits.

use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::Ordering;

use crate::store::references::references;
use crate::store::{Store, StoreError, sql};
use relume_api::TenantId;
use relume_api::usage::{StoredKind, Usage};

/// A storage limit and the stored bytes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Allowance {
    /// The limit, bytes; `u64::MAX` if only the disk limits the storage.
    pub(super) limit: u64,
    /// Stored and pending bytes; computed only if there is a limit.
    pub(super) taken: u64,
    /// Whether the limit is that of a tenant; otherwise it is that of the server.
    pub(super) of_tenant: bool,
}

impl Allowance {
    /// Bytes that may still be stored.
    pub(super) fn left(&self) -> u64 {
        self.limit.saturating_sub(self.taken)
    }

    /// Refuses `asked` more bytes beyond the limit.
    pub(super) fn admit(&self, asked: u64) -> Result<(), StoreError> {
        let (limit, taken) = (self.limit, self.taken);
        match self.of_tenant {
            _ if asked <= self.left() => Ok(()),
            true => Err(StoreError::ByteQuotaExceeded { most: limit, taken, asked }),
            false => Err(StoreError::StorageLimitExceeded { limit, taken, asked }),
        }
    }
}

impl Store {
    /// Sets the storage limit, bytes.
    pub fn limit_disk(&self, bytes: u64) {
        self.disk_limit.store(bytes, Ordering::SeqCst);
    }

    /// Counts the stored bytes of a tenant. With `of_server` the result also contains data about the whole server: unreferenced
    /// bytes, the storage limit and the free disk space.
    ///
    /// # Errors
    /// When the database or the directory cannot be read.
    pub async fn usage(&self, tenant: &TenantId, of_server: bool) -> Result<Usage, StoreError> {
        let named = references(self.pool()).await?;
        let root = self.artifacts.local_path("");
        let (files, free_bytes) = tokio::task::spawn_blocking(move || {
            let mut files = HashMap::new();
            sizes(&root, "", &mut files)?;
            let disk = rustix::fs::statvfs(&root)?;
            Ok::<_, std::io::Error>((files, disk.f_bavail.saturating_mul(disk.f_frsize)))
        })
        .await
        .map_err(std::io::Error::other)??;
        let mut files = files;
        if let (true, Some(remote)) = (of_server, self.artifacts.remote()) {
            // A local copy counts once, together with its object.
            files.extend(remote.list("").await?.into_iter().map(|object| (object.key, object.bytes)));
        }
        let all: u64 = files.values().sum();
        // Several rows may reference one file.
        let mut mine: Vec<&str> = named.iter().map(|reference| reference.artifact.as_str()).collect();
        mine.sort_unstable();
        mine.dedup();
        let referenced: u64 = mine.iter().filter_map(|key| files.get(*key)).sum();
        let disk_limit = Some(self.disk_limit()).filter(|limit| *limit < u64::MAX);
        Ok(Usage {
            captures: self
                .kind(
                    "SELECT COUNT(*), CAST(SUM(bytes) AS BIGINT) FROM captures WHERE tenant = $1 AND deleted_ms IS NULL",
                    tenant,
                )
                .await?,
            environments: self
                .kind(
                    "SELECT COUNT(*), CAST(SUM(bytes) AS BIGINT) FROM environments WHERE tenant = $1 AND deleted_ms IS NULL",
                    tenant,
                )
                .await?,
            models: self
                .kind(
                    "SELECT COUNT(DISTINCT models.id), CAST(SUM(bytes) AS BIGINT) FROM models
                     LEFT JOIN model_files ON model_id = models.id WHERE tenant = $1 AND deleted_ms IS NULL",
                    tenant,
                )
                .await?,
            uploads: self
                .kind("SELECT COUNT(*), CAST(SUM(received) AS BIGINT) FROM uploads WHERE tenant = $1", tenant)
                .await?,
            exports: self
                .kind(
                    "SELECT COUNT(*), CAST(SUM(COALESCE(bytes, 0) + work_bytes) AS BIGINT) FROM exports
                     WHERE tenant = $1 AND deleted_ms IS NULL",
                    tenant,
                )
                .await?,
            checkpoints: self.checkpoints(Some(tenant)).await?,
            unreferenced_bytes: if of_server { all.saturating_sub(referenced) } else { 0 },
            limit_bytes: self.quota.bytes.or(disk_limit.filter(|_| of_server)),
            free_bytes: of_server.then_some(free_bytes),
        })
    }

    /// Refuses `asked` more bytes beyond the limit, which includes pending uploads. If the limit is already reached, refuses any
    /// further bytes.
    ///
    /// # Errors
    /// [`StoreError::StorageLimitExceeded`], with the numbers.
    pub async fn admit_bytes(&self, asked: u64) -> Result<(), StoreError> {
        self.disk_allowance().await?.admit(asked.max(1))
    }

    /// The storage limit of the server and its stored bytes, including pending uploads.
    pub(super) async fn disk_allowance(&self) -> Result<Allowance, StoreError> {
        let limit = self.disk_limit();
        let taken = match limit {
            u64::MAX => 0,
            _ => self.stored_bytes().await?.saturating_add(self.pending_quota.all()),
        };
        Ok(Allowance { limit, taken, of_tenant: false })
    }

    fn disk_limit(&self) -> u64 {
        self.disk_limit.load(Ordering::SeqCst)
    }

    /// Stored bytes, including deleted resources whose files are not removed yet.
    async fn stored_bytes(&self) -> Result<u64, StoreError> {
        let bytes: i64 = sql::query_scalar(
            "SELECT CAST(
                    COALESCE((SELECT SUM(bytes) FROM
                        (SELECT DISTINCT artifact, bytes FROM captures WHERE swept_ms IS NULL) AS of_captures), 0)
                  + COALESCE((SELECT SUM(bytes) FROM
                        (SELECT DISTINCT artifact, bytes FROM environments) AS of_environments), 0)
                  + COALESCE((SELECT SUM(received) FROM uploads), 0)
                  + COALESCE((SELECT SUM(bytes) FROM model_files), 0)
                  + COALESCE((SELECT SUM(COALESCE(bytes, 0) + work_bytes) FROM exports), 0) AS BIGINT)",
        )
        .fetch_one(self.pool())
        .await?;
        Ok(u64::try_from(bytes).unwrap_or(0) + self.checkpoints(None).await?.bytes)
    }

    async fn checkpoints(&self, of: Option<&TenantId>) -> Result<StoredKind, StoreError> {
        let keys: Vec<String> = sql::query_scalar(
            "SELECT checkpoint FROM jobs
             WHERE checkpoint IS NOT NULL AND state IN ('queued', 'running', 'cancelling')
                 AND ($1 IS NULL OR tenant = $1)",
        )
        .bind(of)
        .fetch_all(self.pool())
        .await?;
        let mut found = StoredKind::default();
        for key in keys {
            // A checkpoint that is replaced in the meantime is not counted.
            let Some(bytes) = self.artifacts.size(&key).await? else { continue };
            found.count += 1;
            found.bytes += bytes;
        }
        Ok(found)
    }

    async fn kind(&self, query: &'static str, tenant: &TenantId) -> Result<StoredKind, StoreError> {
        let (count, bytes): (i64, Option<i64>) =
            sql::query_as(query).bind(tenant).fetch_one(self.pool()).await?;
        let natural = |number: i64| u64::try_from(number).unwrap_or(0);
        Ok(StoredKind { count: natural(count), bytes: natural(bytes.unwrap_or(0)) })
    }
}

/// The sizes of all files under a folder, by their relative paths. Files that are removed in the meantime are omitted.
fn sizes(folder: &Path, prefix: &str, files: &mut HashMap<String, u64>) -> std::io::Result<()> {
    let entries = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        let entry = entry?;
        let key = format!("{prefix}{}", entry.file_name().to_string_lossy());
        let Ok(found) = entry.metadata() else { continue };
        if found.is_dir() {
            sizes(&entry.path(), &format!("{key}/"), files)?;
        } else {
            files.insert(key, found.len());
        }
    }
    Ok(())
}
