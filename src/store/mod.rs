//! Metadata in SQLite or PostgreSQL and artifacts in a folder or an object store. SQL text lives here and nowhere else.
//!
//! Every change that a client may have been told of is one transaction; SQLite works in WAL mode with `synchronous=FULL`. Times come in as milliseconds since 1970 UTC, so that callers can inject a clock.

mod admission;
mod artifacts;
mod backup;
mod captures;
mod data_dir_lock;
mod database;
mod database_copy;
mod deletion;
mod deliveries;
mod discard;
mod disk_space;
mod environments;
mod error;
mod events;
mod exports;
mod folder;
mod hash;
mod idempotency;
mod inspection;
mod job_view;
mod jobs;
mod key_token;
mod keys;
mod leases;
mod metadata;
mod models;
mod orphan_cleanup;
mod page;
mod pending_quota;
mod publish;
mod quality_result;
mod quota;
mod receive;
mod reconciliation;
mod records;
mod references;
mod reservation;
mod retention;
mod sql;
mod staged_upload;
mod uploads;
mod usage;
mod verification;
mod webhooks;
mod workers;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use tokio::sync::Mutex;

use database::{Database, DatabaseFile, DatabaseServer};
use pending_quota::PendingQuota;
use sql::{Pool, Sql, Tx};
use uploads::UploadLocks;

pub use artifacts::{Artifacts, ArtifactsRedirect, ArtifactsUrl, ObjectStoreConfig};
pub use backup::{Backup, backup, backup_with, restore};
pub use data_dir_lock::DataDirLock;
pub use database::{DatabaseUrl, JobChangeListener, ServerLock};
pub use database_copy::{CopiedTable, DatabaseLocation, copy_database};
pub use deletion::Deletion;
pub use deliveries::{DeliveryAttempt, DeliveryRecord, Replay};
pub use discard::DeletionReport;
pub use disk_space::DiskSpace;
pub use error::StoreError;
pub use exports::{ClaimedExport, ExportDeletion, ExportRecord, ExportedFile};
pub use folder::make_private;
pub use hash::hex;
pub use idempotency::IdempotencyKey;
pub use inspection::{Inspection, inspect, inspect_with};
pub use job_view::rfc3339;
pub use jobs::{CancelOutcome, MAX_QUEUE_POSITION, Submitted};
pub use key_token::KeyToken;
pub use keys::{NewKeyRecord, has_keys};
pub use leases::Claimant;
pub use metadata::Filter;
pub use orphan_cleanup::OrphanCleanup;
pub use page::{InvalidCursor, Page, PageCursor, Paginated};
pub use quality_result::QualityResult;
pub use quota::Quota;
pub use reconciliation::ReconciliationReport;
pub use records::{
    CaptureRecord, EnvironmentRecord, EventRecord, JobRecord, KeyRecord, ModelFile, ModelRecord,
};
pub use relume_api::work::{LeaseStatus, Release};
pub use retention::Retention;
pub use staged_upload::StagedUpload;
pub use uploads::{Checksum, Piece, UploadLimits, UploadLock, UploadRecord};
pub use webhooks::WebhookRecord;
pub use workers::WorkerRecord;

/// The metadata database and the artifact store of one data directory.
#[derive(Clone)]
pub struct Store {
    database: Database,
    artifacts: Artifacts,
    disk_space: DiskSpace,
    quota: Quota,
    root: PathBuf,
    /// Most bytes that are stored; `u64::MAX` when the disk alone is the limit.
    disk_limit: Arc<AtomicU64>,
    /// Held while a file and the row that names it are made or removed together.
    publish_lock: Arc<Mutex<()>>,
    /// What is on its way to it.
    pending_quota: PendingQuota,
    /// Which uploads somebody works on.
    upload_locks: UploadLocks,
}

impl Store {
    /// Opens the data directory, creates what is missing and migrates the schema. A directory that is made is its owner's alone.
    ///
    /// # Errors
    /// When the directory cannot be created, or the database cannot be opened or migrated; [`StoreError::DatabaseMissing`] when
    /// there are artifacts and no database.
    pub async fn open(root: &Path) -> Result<Self, StoreError> {
        Self::open_with(root, None).await
    }

    /// As [`Store::open`], with the metadata on a PostgreSQL server where one is given.
    ///
    /// # Errors
    /// As [`Store::open`].
    pub async fn open_with(root: &Path, url: Option<&DatabaseUrl>) -> Result<Self, StoreError> {
        folder::make_private(root)?;
        if url.is_none() && !root.join(database::FILE).exists() && has_artifacts(root)? {
            return Err(StoreError::DatabaseMissing(root.display().to_string()));
        }
        let database = Database::open(root, url).await?;
        Ok(Self {
            database,
            artifacts: Artifacts::open(root)?,
            disk_space: DiskSpace::new(root),
            quota: Quota::default(),
            root: root.to_owned(),
            disk_limit: Arc::new(AtomicU64::new(u64::MAX)),
            publish_lock: Arc::default(),
            pending_quota: PendingQuota::default(),
            upload_locks: UploadLocks::default(),
        })
    }

    /// With artifacts in an object store, of which the folder is a cache from then on. Nothing is asked of it yet.
    ///
    /// # Errors
    /// When a setting of it is missing or wrong, or the folder cannot be read.
    pub fn with_artifacts(mut self, config: &ObjectStoreConfig) -> Result<Self, StoreError> {
        self.artifacts = self.artifacts.with_object_store(config)?;
        Ok(self)
    }

    /// Opens the data directory of a server that runs. Nothing is migrated beneath it.
    ///
    /// # Errors
    /// As [`Store::open`]; [`StoreError::OlderServer`] when the server would not understand this version's schema.
    pub async fn open_existing(root: &Path, url: Option<&DatabaseUrl>) -> Result<Self, StoreError> {
        let (found, known) = match url {
            Some(url) => (DatabaseServer::schema_of(url).await?, database::server_schema()),
            None => (DatabaseFile::schema_of(root).await?, database::schema()),
        };
        if found < known {
            Err(StoreError::OlderServer { found, known })
        } else {
            Self::open_with(root, url).await
        }
    }

    /// The artifact side.
    pub fn artifacts(&self) -> &Artifacts {
        &self.artifacts
    }

    /// Disk space.
    pub fn disk_space(&self) -> &DiskSpace {
        &self.disk_space
    }

    /// As [`DiskSpace::check`], off the async threads.
    ///
    /// # Errors
    /// See [`DiskSpace::check`].
    pub async fn check_disk_space(&self) -> Result<(), StoreError> {
        let disk_space = self.disk_space.clone();
        let checked = tokio::task::spawn_blocking(move || disk_space.check()).await;
        checked.unwrap_or_else(|error| Err(std::io::Error::other(error).into()))
    }

    /// Refuses new work while there is no room for the work that waits, or no more may be stored.
    async fn admit(&self) -> Result<(), StoreError> {
        self.admit_bytes(0).await?;
        if self.disk_space.is_short() { self.check_disk_space().await } else { Ok(()) }
    }

    /// The data directory.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Answers when the database does.
    ///
    /// # Errors
    /// When it does not.
    pub async fn ping(&self) -> Result<(), StoreError> {
        sql::query("SELECT 1").execute(self.pool()).await?;
        Ok(())
    }

    /// Name and version of the database.
    ///
    /// # Errors
    /// When the database does not answer.
    pub async fn database_version(&self) -> Result<String, StoreError> {
        let query = Sql::each(
            "SELECT 'SQLite ' || sqlite_version()",
            "SELECT 'PostgreSQL ' || current_setting('server_version')",
        );
        Ok(sql::query_scalar(query).fetch_one(self.pool()).await?)
    }

    /// Bytes that the database takes.
    ///
    /// # Errors
    /// When the database does not answer.
    pub async fn database_size(&self) -> Result<u64, StoreError> {
        let query = Sql::each(
            "SELECT page_count * page_size FROM pragma_page_count(), pragma_page_size()",
            "SELECT pg_database_size(current_database())",
        );
        let bytes: i64 = sql::query_scalar(query).fetch_one(self.pool()).await?;
        Ok(u64::try_from(bytes).unwrap_or(0))
    }

    /// The time of the database, milliseconds since 1970 UTC: one time for all that share it. `None` of a database that has no clock
    /// but this machine's.
    ///
    /// # Errors
    /// When the database does not answer.
    pub async fn database_time(&self) -> Result<Option<i64>, StoreError> {
        self.database.time().await
    }

    /// Becomes the first server on a shared database until what this returns is dropped.
    ///
    /// # Errors
    /// [`StoreError::DatabaseLocked`] when there is one; when the database cannot be reached.
    pub async fn lock_database(&self) -> Result<ServerLock, StoreError> {
        self.database.lock().await
    }

    /// Hears of what anybody who shares the database writes about jobs.
    ///
    /// # Errors
    /// When the database cannot be reached.
    pub async fn listen(&self) -> Result<JobChangeListener, StoreError> {
        self.database.listen().await
    }

    /// Closes every connection; the WAL is folded into the database file.
    pub async fn close(&self) {
        self.database.close().await;
    }

    /// Connections for queries.
    fn pool(&self) -> &Pool {
        self.database.readers()
    }

    async fn write(&self) -> Result<Tx, StoreError> {
        self.database.write().await
    }

    /// See [`Database::write_row`].
    async fn write_row(&self) -> Result<Tx, StoreError> {
        self.database.write_row().await
    }
}

/// Name of the database while a backup is restored.
const RESTORING: &str = "relume.db.restoring";

/// True when there are artifacts in a data directory, or a backup was half restored to it.
fn has_artifacts(root: &Path) -> Result<bool, StoreError> {
    Ok(root.join(RESTORING).exists() || !references::artifact_keys(&root.join("artifacts"))?.is_empty())
}
