//! A PostgreSQL database that several servers share.

use std::sync::Arc;
use std::time::Duration;

use sqlx::migrate::{MigrateError, Migrator};
use sqlx::postgres::{PgListener, PgPoolOptions};
use sqlx::{Connection, PgConnection, PgPool};
use tokio::sync::Mutex;

use crate::store::StoreError;
use crate::store::database::url::DatabaseUrl;
use crate::store::sql::{Pool, Tx};

static MIGRATIONS: Migrator = sqlx::migrate!("migrations/postgres");
/// Connections of one server for reading, and a separate pool for writing, so that waiting writers do not block readers.
const READERS: u32 = 8;
const WRITERS: u32 = 8;
/// Timeout for obtaining a connection.
const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(10);
/// Key of the advisory lock that serialises writers: "relume" in ASCII.
const WRITER_LOCK_KEY: i64 = 0x7265_6c75_6d65;
/// Key of the advisory lock of the first server.
const SERVER_LOCK_KEY: i64 = WRITER_LOCK_KEY + 1;

/// Number of attempts to retake a lost lock that seems to be held, and the delay between them.
const MAX_LOCK_ATTEMPTS: u32 = 20;
const LOCK_RETRY_INTERVAL: Duration = Duration::from_millis(250);

/// The lock of the first server, with the database backend of its connection.
pub(super) struct HeldLock {
    connection: PgConnection,
    pid: i32,
    started: String,
}

/// Connections to one PostgreSQL database.
#[derive(Clone)]
pub(in crate::store) struct DatabaseServer {
    connections: PgPool,
    readers: Pool,
    /// Serialises the writers of this process, so that waiting writers use no connection.
    writing: Arc<Mutex<()>>,
}

impl DatabaseServer {
    /// Connects to `url` and migrates the schema.
    pub(super) async fn open(url: &DatabaseUrl) -> Result<Self, StoreError> {
        let pool = |size| PgPoolOptions::new().max_connections(size).acquire_timeout(ACQUIRE_TIMEOUT);
        let connections = pool(WRITERS).connect_with((*url.0).clone()).await?;
        MIGRATIONS.run(&connections).await.map_err(|error| match error {
            MigrateError::VersionMissing(found) if found > schema() => {
                StoreError::NewerDatabase { found, known: schema() }
            }
            MigrateError::Execute(error) | MigrateError::ExecuteMigration(error, _) => error.into(),
            error => StoreError::Migration(error),
        })?;
        let readers = Pool::Postgres(pool(READERS).connect_with((*url.0).clone()).await?);
        Ok(Self { connections, readers, writing: Arc::default() })
    }

    /// Opens one read-only connection to the database at `url`.
    pub(super) async fn open_read_only(url: &DatabaseUrl) -> Result<Pool, StoreError> {
        let options = (*url.0).clone().options([("default_transaction_read_only", "on")]);
        let pool = PgPoolOptions::new().max_connections(1).acquire_timeout(ACQUIRE_TIMEOUT);
        Ok(Pool::Postgres(pool.connect_with(options).await?))
    }

    /// Whether the database at `url` has `table` and `query` returns true. Does not migrate.
    pub(in crate::store) async fn has(
        url: &DatabaseUrl,
        table: &'static str,
        query: &'static str,
    ) -> Result<bool, StoreError> {
        let mut connection = PgConnection::connect_with(&url.0).await?;
        let there = sqlx::query_scalar("SELECT to_regclass($1) IS NOT NULL").bind(table);
        let found = there.fetch_one(&mut connection).await?
            && sqlx::query_scalar(query).fetch_one(&mut connection).await?;
        connection.close().await?;
        Ok(found)
    }

    /// The schema version of the database at `url`; 0 if it has none.
    pub(in crate::store) async fn schema_of(url: &DatabaseUrl) -> Result<i64, StoreError> {
        let mut connection = PgConnection::connect_with(&url.0).await?;
        let there = sqlx::query_scalar("SELECT to_regclass('_sqlx_migrations') IS NOT NULL");
        let mut found = Some(0);
        if there.fetch_one(&mut connection).await? {
            let query = sqlx::query_scalar("SELECT MAX(version) FROM _sqlx_migrations");
            found = query.fetch_one(&mut connection).await?;
        }
        connection.close().await?;
        Ok(found.unwrap_or(0))
    }

    /// Connections for queries.
    pub(super) fn pool(&self) -> &Pool {
        &self.readers
    }

    /// A transaction that is serialised with the write transactions of all servers.
    pub(super) async fn write(&self) -> Result<Tx, StoreError> {
        let waited = self.writing.clone().lock_owned().await;
        let mut tx = self.connections.begin().await?;
        sqlx::query("SELECT pg_advisory_xact_lock($1)").bind(WRITER_LOCK_KEY).execute(&mut *tx).await?;
        Ok(Tx::Postgres(tx, Some(waited)))
    }

    /// A transaction that sees a snapshot from its first statement.
    pub(super) async fn snapshot(&self) -> Result<Tx, StoreError> {
        let begin = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY";
        Ok(Tx::Postgres(self.connections.begin_with(begin).await?, None))
    }

    /// A transaction that waits only for the rows that it changes.
    pub(super) async fn begin(&self) -> Result<Tx, StoreError> {
        Ok(Tx::Postgres(self.connections.begin().await?, None))
    }

    /// The time of the database, milliseconds since 1970 UTC.
    pub(super) async fn time(&self) -> Result<i64, StoreError> {
        let query = sqlx::query_scalar("SELECT CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000 AS BIGINT)");
        Ok(query.fetch_one(&self.connections).await?)
    }

    /// Takes the lock of the first server. It is held until the returned value is dropped or its connection ends.
    pub(super) async fn lock(&self) -> Result<HeldLock, StoreError> {
        // A separate connection that is not returned to the pool.
        let mut connection = self.connections.acquire().await?.detach();
        let query = sqlx::query_scalar("SELECT pg_try_advisory_lock($1)");
        if !query.bind(SERVER_LOCK_KEY).fetch_one(&mut connection).await? {
            return Err(StoreError::DatabaseLocked);
        }
        let query =
            "SELECT pid, CAST(backend_start AS TEXT) FROM pg_stat_activity WHERE pid = pg_backend_pid()";
        let (pid, started) = sqlx::query_as(query).fetch_one(&mut connection).await?;
        Ok(HeldLock { connection, pid, started })
    }

    /// Takes the lock again if its connection was lost. The database may still hold the lock for the lost connection, so this
    /// terminates the backend of that connection.
    pub(super) async fn keep(&self, held: &mut HeldLock) -> Result<(), StoreError> {
        if let Ok(Ok(())) = tokio::time::timeout(ACQUIRE_TIMEOUT, held.connection.ping()).await {
            return Ok(());
        }
        let end = "SELECT COUNT(pg_terminate_backend(pid)) FROM pg_stat_activity
             WHERE pid = $1 AND CAST(backend_start AS TEXT) = $2";
        sqlx::query(end).bind(held.pid).bind(&held.started).execute(&self.connections).await?;
        for _ in 0..MAX_LOCK_ATTEMPTS {
            match self.lock().await {
                Err(StoreError::DatabaseLocked) => tokio::time::sleep(LOCK_RETRY_INTERVAL).await,
                lock => {
                    *held = lock?;
                    return Ok(());
                }
            }
        }
        Err(StoreError::DatabaseLocked)
    }

    /// A connection that receives the notifications of all servers about jobs.
    pub(super) async fn listen(&self) -> Result<PgListener, StoreError> {
        let mut listener = PgListener::connect_with(&self.connections).await?;
        listener.listen("relume_jobs").await?;
        Ok(listener)
    }

    /// Closes all connections.
    pub(super) async fn close(&self) {
        self.connections.close().await;
        if let Pool::Postgres(readers) = &self.readers {
            readers.close().await;
        }
    }
}

/// The schema version of this program.
pub(in crate::store) fn schema() -> i64 {
    MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0)
}
