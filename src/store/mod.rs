//! Metadata in SQLite and artifacts in an object store. SQL text lives here and nowhere else.
//!
//! Every change that a client may have been told of is one transaction on a database in WAL mode
//! with `synchronous=FULL`. Times come in as milliseconds since 1970 UTC, so that callers can inject a clock.

mod artifacts;
mod captures;
mod environments;
mod error;
mod events;
mod idempotency;
mod jobs;
mod leases;
mod models;
mod node_lock;
mod records;

use std::path::{Path, PathBuf};
use std::time::Duration;

use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{Sqlite, SqlitePool, Transaction};

pub use artifacts::{Artifacts, Incoming, hex};
pub use error::StoreError;
pub use idempotency::IdempotencyKey;
pub use jobs::{CancelOutcome, Submitted};
pub use leases::{LeaseStatus, Release};
pub use node_lock::NodeLock;
pub use records::{CaptureRecord, EnvironmentRecord, EventRecord, JobRecord, ModelFile, ModelRecord, Page};

/// The metadata database and the artifact store of one data directory.
#[derive(Clone)]
pub struct Store {
    pool: SqlitePool,
    artifacts: Artifacts,
    root: PathBuf,
}

impl Store {
    /// Opens the data directory, creates what is missing and migrates the schema.
    ///
    /// # Errors
    /// When the directory cannot be created, or the database cannot be opened or migrated.
    pub async fn open(root: &Path) -> Result<Self, StoreError> {
        std::fs::create_dir_all(root)?;
        let options = SqliteConnectOptions::new()
            .filename(root.join("relume.db"))
            .create_if_missing(true)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .busy_timeout(Duration::from_secs(10))
            .foreign_keys(true);
        let pool = SqlitePoolOptions::new().max_connections(8).connect_with(options).await?;
        sqlx::migrate!("migrations/sqlite").run(&pool).await?;
        Ok(Self { pool, artifacts: Artifacts::open(root)?, root: root.to_owned() })
    }

    /// The artifact side.
    pub fn artifacts(&self) -> &Artifacts {
        &self.artifacts
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
        sqlx::query("SELECT 1").execute(&self.pool).await?;
        Ok(())
    }

    /// The SQLite library's version.
    ///
    /// # Errors
    /// When the database does not answer.
    pub async fn sqlite_version(&self) -> Result<String, StoreError> {
        Ok(sqlx::query_scalar("SELECT sqlite_version()").fetch_one(&self.pool).await?)
    }

    /// Closes every connection; the WAL is folded into the database file.
    pub async fn close(&self) {
        self.pool.close().await;
    }

    /// A transaction that takes the write lock at once, so that it cannot fail half way for want of it.
    async fn write(&self) -> Result<Transaction<'static, Sqlite>, StoreError> {
        Ok(self.pool.begin_with("BEGIN IMMEDIATE").await?)
    }
}
