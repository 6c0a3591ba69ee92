//! The database: a file of SQLite, or a server of PostgreSQL that several nodes share. Both keep the same promises.

mod postgres;
mod sqlite;
mod url;

use std::path::Path;

use sqlx::postgres::PgListener;

use crate::store::StoreError;
use crate::store::sql::{Pool, Tx};

use postgres::HeldLock;
pub(super) use postgres::{DatabaseServer, schema as server_schema};
pub(super) use sqlite::{DatabaseFile, FILE, schema};
pub use url::DatabaseUrl;

/// Being the first server on a database: a lock that ends with its connection. A file of SQLite has the lock of its data directory.
pub struct ServerLock(Option<(DatabaseServer, HeldLock)>);

impl ServerLock {
    /// Sees to it that the lock is still held: it is lost with its connection, e.g. when the database starts anew.
    ///
    /// # Errors
    /// [`StoreError::DatabaseLocked`] when another server has it by now; when the database cannot be reached.
    pub async fn renew(&mut self) -> Result<(), StoreError> {
        match &mut self.0 {
            Some((server, held)) => server.keep(held).await,
            None => Ok(()),
        }
    }
}

/// Hears of what others write about jobs.
pub struct JobChangeListener(Option<PgListener>);

impl JobChangeListener {
    /// Waits until something was written, or the connection was lost and is there again: then something may have been. A file of
    /// SQLite has one process that writes, so there it waits for ever.
    ///
    /// # Errors
    /// When the database cannot be reached.
    pub async fn wait_for_change(&mut self) -> Result<(), StoreError> {
        match &mut self.0 {
            None => std::future::pending().await,
            Some(listener) => Ok(listener.try_recv().await.map(drop)?),
        }
    }
}

/// A database that is only looked at.
pub(super) struct ReadOnlyDatabase {
    pub(super) pool: Pool,
    /// Number of the schema that this program knows for it.
    pub(super) known: i64,
}

/// Connections to the database of a store.
#[derive(Clone)]
pub(super) enum Database {
    File(DatabaseFile),
    Server(DatabaseServer),
}

impl Database {
    /// Opens `root/relume.db`, or the server at `url` (`postgres://...`), and migrates the schema.
    pub(super) async fn open(root: &Path, url: Option<&DatabaseUrl>) -> Result<Self, StoreError> {
        match url {
            None => Ok(Self::File(DatabaseFile::open(root).await?)),
            Some(url) => Ok(Self::Server(DatabaseServer::open(url).await?)),
        }
    }

    /// What is there already, by one connection that changes nothing: `root/relume.db`, or the server at `url`.
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

    /// A new file of SQLite of whichever name.
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

    /// A transaction that changes nothing and sees everything as it was at one moment.
    pub(super) async fn snapshot(&self) -> Result<Tx, StoreError> {
        match self {
            Self::File(file) => file.snapshot().await,
            Self::Server(server) => server.snapshot().await,
        }
    }

    /// A transaction that changes something, one at a time: what it has read stays true until it ends.
    pub(super) async fn write(&self) -> Result<Tx, StoreError> {
        match self {
            Self::File(file) => file.write().await,
            Self::Server(server) => server.write().await,
        }
    }

    /// A transaction whose first statement changes the one row that all of it is about. Where the database has several writers it
    /// waits for nobody who writes something else.
    pub(super) async fn write_row(&self) -> Result<Tx, StoreError> {
        match self {
            Self::File(file) => file.write().await,
            Self::Server(server) => server.begin().await,
        }
    }

    /// The time of a server, milliseconds since 1970 UTC; a file has none of its own.
    pub(super) async fn time(&self) -> Result<Option<i64>, StoreError> {
        match self {
            Self::File(_) => Ok(None),
            Self::Server(server) => Ok(Some(server.time().await?)),
        }
    }

    /// Becomes the first server on it.
    pub(super) async fn lock(&self) -> Result<ServerLock, StoreError> {
        Ok(ServerLock(match self {
            Self::File(_) => None,
            Self::Server(server) => Some((server.clone(), server.lock().await?)),
        }))
    }

    /// Who is told when somebody writes about a job.
    pub(super) async fn listen(&self) -> Result<JobChangeListener, StoreError> {
        match self {
            Self::File(_) => Ok(JobChangeListener(None)),
            Self::Server(server) => Ok(JobChangeListener(Some(server.listen().await?))),
        }
    }

    /// Closes every connection.
    pub(super) async fn close(&self) {
        match self {
            Self::File(file) => file.close().await,
            Self::Server(server) => server.close().await,
        }
    }
}
