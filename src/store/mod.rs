//! Metadata in SQLite or PostgreSQL, and artifacts in a folder or an object store. Only this module contains SQL.
//!
//! Every change that is reported to a client is one transaction. SQLite uses WAL mode with `synchronous=FULL`. Times are
//! milliseconds since 1970 UTC and are passed in, so that callers can inject a clock.

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
mod model_replacement;
mod models;
mod orphan_cleanup;
mod ownership;
mod page;
mod pending_quota;
mod preemption;
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
use model_replacement::ReplacedArtifacts;
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
pub use inspection::{Inspection, failure_codes, inspect, inspect_with};
pub use job_view::rfc3339;
pub use jobs::{CancelOutcome, MAX_QUEUE_POSITION, Submitted};
pub use key_token::KeyToken;
pub use keys::{NewKeyRecord, has_keys};
pub use leases::Claimant;
pub use metadata::Filter;
pub use model_replacement::ModelReplacement;
pub use orphan_cleanup::OrphanCleanup;
pub use page::{InvalidCursor, Page, PageCursor, Paginated};
pub use quality_result::QualityResult;
pub use quota::Quota;
pub use reconciliation::ReconciliationReport;
pub use records::{
    CaptureRecord, EnvironmentRecord, EventRecord, JobRecord, KeyRecord, ModelFile, ModelRecord,
};
pub use relume_api::work::{LeaseStatus, Release};
pub use retention::{ExpiryCounts, Retention};
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
    /// Storage limit, bytes; `u64::MAX` if only the disk limits the storage.
    disk_limit: Arc<AtomicU64>,
    /// Held while a file and its row are created or removed together.
    publish_lock: Arc<Mutex<()>>,
    /// The bytes of pending uploads.
    pending_quota: PendingQuota,
    /// The locks of uploads.
    upload_locks: UploadLocks,
    /// Replaced artifacts of models that are still to be removed.
    replaced_artifacts: ReplacedArtifacts,
}

impl Store {
    /// Opens the data directory, creates missing files and migrates the schema. A new directory is accessible only to its owner.
    ///
    /// # Errors
    /// When the directory cannot be created, or the database cannot be opened or migrated; [`StoreError::DatabaseMissing`],
    /// [`StoreError::DatabaseEmpty`] or [`StoreError::ForeignArtifacts`] if there are artifacts of another database.
    pub async fn open(root: &Path) -> Result<Self, StoreError> {
        Self::open_with(root, None).await
    }

    /// As [`Store::open`], with the metadata in the PostgreSQL database at `url`, if given.
    ///
    /// # Errors
    /// As [`Store::open`].
    pub async fn open_with(root: &Path, url: Option<&DatabaseUrl>) -> Result<Self, StoreError> {
        folder::make_private(root)?;
        ownership::check_before_migration(root, url).await?;
        let database = Database::open(root, url).await?;
        ownership::check_owner(root, &database).await?;
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
            replaced_artifacts: ReplacedArtifacts::default(),
        })
    }

    /// Stores artifacts in an object store, with the folder as its cache. Sends no request yet.
    ///
    /// # Errors
    /// If a setting is missing or invalid, or if the folder cannot be read.
    pub fn with_artifacts(mut self, config: &ObjectStoreConfig) -> Result<Self, StoreError> {
        self.artifacts = self.artifacts.with_object_store(config)?;
        Ok(self)
    }

    /// Opens the data directory of a running server. Does not migrate.
    ///
    /// # Errors
    /// As [`Store::open`]; [`StoreError::OlderServer`] if the running server does not support this version's schema.
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

    /// The artifact store.
    pub fn artifacts(&self) -> &Artifacts {
        &self.artifacts
    }

    /// The disk space of the data directory.
    pub fn disk_space(&self) -> &DiskSpace {
        &self.disk_space
    }

    /// As [`DiskSpace::check`], on a blocking thread.
    ///
    /// # Errors
    /// See [`DiskSpace::check`].
    pub async fn check_disk_space(&self) -> Result<(), StoreError> {
        let disk_space = self.disk_space.clone();
        let checked = tokio::task::spawn_blocking(move || disk_space.check()).await;
        checked.unwrap_or_else(|error| Err(std::io::Error::other(error).into()))
    }

    /// Refuses new work while the disk space is insufficient or the storage limit is reached.
    async fn admit(&self) -> Result<(), StoreError> {
        self.admit_bytes(0).await?;
        if self.disk_space.is_short() { self.check_disk_space().await } else { Ok(()) }
    }

    /// The data directory.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Checks that the database answers.
    ///
    /// # Errors
    /// When the database does not answer.
    pub async fn ping(&self) -> Result<(), StoreError> {
        // A constant would be answered without a look at the file.
        for query in [
            "SELECT count(*) FROM _sqlx_migrations",
            "SELECT state, overrides FROM jobs ORDER BY id DESC LIMIT 1",
            "SELECT report FROM captures ORDER BY id DESC LIMIT 1",
            "SELECT card FROM models ORDER BY id DESC LIMIT 1",
        ] {
            sql::query(query).execute(self.pool()).await?;
        }
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

    /// Size of the database, bytes.
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

    /// The time of the database, milliseconds since 1970 UTC, which is the same for all servers that share it. `None` for a
    /// database without its own clock.
    ///
    /// # Errors
    /// When the database does not answer.
    pub async fn database_time(&self) -> Result<Option<i64>, StoreError> {
        self.database.time().await
    }

    /// Takes the lock of the first server on a shared database, until the returned value is dropped.
    ///
    /// # Errors
    /// [`StoreError::DatabaseLocked`] if another server holds it. When the database cannot be reached.
    pub async fn lock_database(&self) -> Result<ServerLock, StoreError> {
        self.database.lock().await
    }

    /// Starts to listen for changes of jobs by all servers that share the database.
    ///
    /// # Errors
    /// When the database cannot be reached.
    pub async fn listen(&self) -> Result<JobChangeListener, StoreError> {
        self.database.listen().await
    }

    /// Closes all connections. SQLite then writes the WAL into the database file.
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
