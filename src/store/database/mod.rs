//! The database: a SQLite file, or a PostgreSQL database that several servers share. Both give the same guarantees.

mod postgres;
mod sqlite;
mod url;

use std::path::Path;

use sqlx::postgres::PgListener;

use crate::store::StoreError;
use crate::store::sql::{Pool, Tx};
use relume_api::JobId;

use postgres::HeldLock;
pub(super) use postgres::{DatabaseServer, schema as server_schema};
pub(super) use sqlite::{DatabaseFile, FILE, schema};
pub use url::DatabaseUrl;

/// The lock of the first server on a database. It ends with its connection. A SQLite file is protected by the lock of its data
/// directory.
pub struct ServerLock(Option<(DatabaseServer, HeldLock)>);

impl ServerLock {
    /// Checks that the lock is still held. It is lost with its connection, e.g. if the database restarts.
    ///
    /// # Errors
    /// [`StoreError::DatabaseLocked`] if another server has taken it. When the database cannot be reached.
    pub async fn renew(&mut self) -> Result<(), StoreError> {
        match &mut self.0 {
            Some((server, held)) => server.keep(held).await,
            None => Ok(()),
        }
    }
}

/// Receives notifications of changes of jobs by other servers.
pub struct JobChangeListener(Option<PgListener>);

impl JobChangeListener {
    /// Waits for a change and returns its job; `None` when a lost connection is restored, because changes of any job may have
    /// been missed. A SQLite file has a single writing process, so this waits forever.
    ///
    /// # Errors
    /// When the database cannot be reached.
    pub async fn wait_for_change(&mut self) -> Result<Option<JobId>, StoreError> {
        match &mut self.0 {
            None => std::future::pending().await,
            Some(listener) => {
                let told = listener.try_recv().await?;
                // Earlier schemas name no job.
                let job = told.map(|told| told.payload().to_owned()).filter(|job| !job.is_empty());
                Ok(job.map(JobId::from))
            }
        }
    }
}

/// A database that is opened read-only.
pub(super) struct ReadOnlyDatabase {
    pub(super) pool: Pool,
    /// The schema version that this program supports for it.
    pub(super) known: i64,
}

/// Connections to the database of a store.
#[derive(Clone)]
pub(super) enum Database {
    File(DatabaseFile),
    Server(DatabaseServer),
}

impl Database {
    /// Opens `root/relume.db` or the database at `url` (`postgres://...`), and migrates the schema.
    pub(super) async fn open(root: &Path, url: Option<&DatabaseUrl>) -> Result<Self, StoreError> {
        match url {
            None => Ok(Self::File(DatabaseFile::open(root).await?)),
            Some(url) => Ok(Self::Server(DatabaseServer::open(url).await?)),
        }
    }

    /// Opens an existing database read-only with one connection: `root/relume.db` or the database at `url`.
    pub(super) async fn open_read_only(
        root: &Path,
        url: Option<&DatabaseUrl>,
    ) -> Result<ReadOnlyDatabase, StoreError> {
        Ok(match url {
            None => {
                let pool = DatabaseFile::open_read_only(root).await?;
                ReadOnlyDatabase { pool: Pool::Sqlite(pool), known: schema() }
            }
            Some(url) => {
                ReadOnlyDatabase { pool: DatabaseServer::open_read_only(url).await?, known: server_schema() }
            }
        })
    }

    /// Creates a SQLite file with any name.
    pub(super) async fn create_file(file: &Path) -> Result<Self, StoreError> {
        Ok(Self::File(DatabaseFile::open_at(file).await?))
    }

    /// Connections for queries.
    pub(super) fn readers(&self) -> &Pool {
        match self {
            Self::File(file) => file.readers(),
            Self::Server(server) => server.pool(),
        }
    }

    /// A read-only transaction on a snapshot of the database.
    pub(super) async fn snapshot(&self) -> Result<Tx, StoreError> {
        match self {
            Self::File(file) => file.snapshot().await,
            Self::Server(server) => server.snapshot().await,
        }
    }

    /// A write transaction. Only one runs at a time, so values that it reads stay valid until it ends.
    pub(super) async fn write(&self) -> Result<Tx, StoreError> {
        match self {
            Self::File(file) => file.write().await,
            Self::Server(server) => server.write().await,
        }
    }

    /// A write transaction whose first statement changes the only row that it is about. If the database supports several writers,
    /// it does not wait for writers of other rows.
    pub(super) async fn write_row(&self) -> Result<Tx, StoreError> {
        match self {
            Self::File(file) => file.write().await,
            Self::Server(server) => server.begin().await,
        }
    }

    /// The time of a database server, milliseconds since 1970 UTC; `None` for a file.
    pub(super) async fn time(&self) -> Result<Option<i64>, StoreError> {
        match self {
            Self::File(_) => Ok(None),
            Self::Server(server) => Ok(Some(server.time().await?)),
        }
    }

    /// Takes the lock of the first server.
    pub(super) async fn lock(&self) -> Result<ServerLock, StoreError> {
        Ok(ServerLock(match self {
            Self::File(_) => None,
            Self::Server(server) => Some((server.clone(), server.lock().await?)),
        }))
    }

    /// Starts to listen for changes of jobs.
    pub(super) async fn listen(&self) -> Result<JobChangeListener, StoreError> {
        match self {
            Self::File(_) => Ok(JobChangeListener(None)),
            Self::Server(server) => Ok(JobChangeListener(Some(server.listen().await?))),
        }
    }

    /// Closes all connections.
    pub(super) async fn close(&self) {
        match self {
            Self::File(file) => file.close().await,
            Self::Server(server) => server.close().await,
        }
    }
}
