//! A SQLite database file with one connection for writing and several for reading, so that a failed write does not affect
//! readers.

use std::path::Path;
use std::time::Duration;

use sqlx::migrate::{MigrateError, Migrator};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{Connection, SqlitePool};

use crate::store::StoreError;
use crate::store::sql::{Pool, Tx};

/// Name of the database in a data directory.
pub(in crate::store) const FILE: &str = "relume.db";
static MIGRATIONS: Migrator = sqlx::migrate!("migrations/sqlite");
/// Connections for reading.
const READERS: u32 = 8;

/// Connections to one database file.
#[derive(Clone)]
pub(in crate::store) struct DatabaseFile {
    /// One connection, because SQLite allows one writer at a time.
    writer: SqlitePool,
    /// Open readers keep the WAL open, so that the writer's connection can be replaced on a full disk.
    readers: SqlitePool,
    pool: Pool,
}

impl DatabaseFile {
    /// Opens `root/relume.db`, creates it if it does not exist, and migrates the schema.
    pub(in crate::store) async fn open(root: &Path) -> Result<Self, StoreError> {
        Self::connect(options(&root.join(FILE)).create_if_missing(true)).await
    }

    /// As [`Self::open`], for a file with another name.
    pub(super) async fn open_at(file: &Path) -> Result<Self, StoreError> {
        Self::connect(options(file).create_if_missing(true)).await
    }

    /// Opens one read-only connection to an existing `root/relume.db`.
    pub(in crate::store) async fn open_read_only(root: &Path) -> Result<SqlitePool, StoreError> {
        let options = options(&root.join(FILE)).pragma("query_only", "ON");
        Ok(SqlitePoolOptions::new().max_connections(1).connect_with(options).await?)
    }

    /// The schema version of an existing `root/relume.db`; 0 if it has none.
    pub(in crate::store) async fn schema_of(root: &Path) -> Result<i64, StoreError> {
        let pool = Self::open_read_only(root).await?;
        let found = async {
            let there = "SELECT EXISTS (SELECT 1 FROM sqlite_master WHERE name = '_sqlx_migrations')";
            let mut found = Some(0);
            if sqlx::query_scalar(there).fetch_one(&pool).await? {
                found =
                    sqlx::query_scalar("SELECT MAX(version) FROM _sqlx_migrations").fetch_one(&pool).await?;
            }
            Ok::<_, sqlx::Error>(found.unwrap_or(0))
        };
        let found = found.await;
        pool.close().await;
        Ok(found?)
    }

    /// Opens one connection to an existing `root/relume.db`, for copying.
    pub(in crate::store) async fn open_to_copy(root: &Path) -> Result<SqlitePool, StoreError> {
        Ok(SqlitePoolOptions::new().max_connections(1).connect_with(options(&root.join(FILE))).await?)
    }

    /// Opens one connection to a copy of a database that no other process uses.
    pub(in crate::store) async fn open_copy(file: &Path, read_only: bool) -> Result<SqlitePool, StoreError> {
        let options = SqliteConnectOptions::new().filename(file).read_only(read_only).immutable(read_only);
        Ok(SqlitePoolOptions::new().max_connections(1).connect_with(options).await?)
    }

    async fn connect(options: SqliteConnectOptions) -> Result<Self, StoreError> {
        let writer = lasting_pool(1)
            .after_release(|connection, _| {
                Box::pin(async move {
                    // A dropped transaction only queues its rollback; this waits for it.
                    connection.ping().await?;
                    // On a full disk SQLite rolls back a transaction itself. The queued rollback then fails, and the connection
                    // considers the transaction open forever. Such a connection is closed instead of reused.
                    Ok(!connection.is_in_transaction())
                })
            })
            .connect_with(options.clone())
            .await?;
        MIGRATIONS.run(&writer).await.map_err(|error| match error {
            MigrateError::VersionMissing(found) if found > schema() => {
                StoreError::NewerDatabase { found, known: schema() }
            }
            MigrateError::Execute(error) | MigrateError::ExecuteMigration(error, _) => error.into(),
            error => StoreError::Migration(error),
        })?;
        let readers = lasting_pool(READERS).connect_with(options.pragma("query_only", "ON")).await?;
        let pool = Pool::Sqlite(readers.clone());
        Ok(Self { writer, readers, pool })
    }

    /// Read-only connections for queries.
    pub(super) fn readers(&self) -> &Pool {
        &self.pool
    }

    /// A transaction that takes the write lock at its start, so that it cannot fail later for lack of the lock.
    pub(super) async fn write(&self) -> Result<Tx, StoreError> {
        Ok(Tx::Sqlite(self.writer.begin_with("BEGIN IMMEDIATE").await?))
    }

    /// A transaction that sees a snapshot from its first statement.
    pub(super) async fn snapshot(&self) -> Result<Tx, StoreError> {
        Ok(Tx::Sqlite(self.readers.begin().await?))
    }

    /// Closes all connections. SQLite then writes the WAL into the database file.
    pub(super) async fn close(&self) {
        self.readers.close().await;
        self.writer.close().await;
    }
}

/// The schema version of this program.
pub(in crate::store) fn schema() -> i64 {
    MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0)
}

fn options(file: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(file)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        .busy_timeout(Duration::from_secs(10))
        .foreign_keys(true)
}

/// A pool whose connections are not closed when idle.
fn lasting_pool(size: u32) -> SqlitePoolOptions {
    SqlitePoolOptions::new().max_connections(size).min_connections(1).idle_timeout(None).max_lifetime(None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::sql;

    /// A database that cannot grow beyond `pages` pages, as on a full disk.
    async fn with_room_for(pages: u32, file: &Path) -> DatabaseFile {
        let options = SqliteConnectOptions::new()
            .filename(file)
            .create_if_missing(true)
            .journal_mode(SqliteJournalMode::Wal)
            .pragma("max_page_count", pages.to_string());
        DatabaseFile::connect(options).await.unwrap()
    }

    async fn insert(database: &DatabaseFile, key: &str, bytes: usize) -> Result<(), StoreError> {
        let mut tx = database.write().await?;
        sql::query(
            "INSERT INTO idempotency (tenant, key, fingerprint, response, created_ms) VALUES ('', $1, '', $2, 0)",
        )
        .bind(key)
        .bind("x".repeat(bytes))
        .execute(&mut tx)
        .await?;
        Ok(tx.commit().await?)
    }

    #[tokio::test]
    async fn writes_succeed_again_after_a_full_disk() {
        let folder = tempfile::tempdir().unwrap();
        let database = with_room_for(100, &folder.path().join(FILE)).await;
        for round in 0..20 {
            let refused = insert(&database, &format!("large {round}"), 1 << 20).await;
            assert!(matches!(refused, Err(StoreError::Full)), "{refused:?}");
            insert(&database, &format!("small {round}"), 1).await.unwrap();
        }
        let count: i64 = sql::query_scalar("SELECT COUNT(*) FROM idempotency")
            .fetch_one(database.readers())
            .await
            .unwrap();
        assert_eq!(count, 20, "refused rows are not stored");
    }

    #[tokio::test]
    async fn metrics_migration_keeps_rows_and_state_constraints() {
        let pool = SqlitePoolOptions::new().max_connections(1).connect("sqlite::memory:").await.unwrap();
        let run = async |sql: &str| {
            let mut tx = pool.begin().await.unwrap();
            sqlx::raw_sql(sqlx::AssertSqlSafe(sql.to_owned())).execute(&mut *tx).await?;
            tx.commit().await
        };
        for migration in MIGRATIONS.iter().filter(|m| m.version <= 3) {
            run(migration.sql.as_str()).await.unwrap();
        }
        run("INSERT INTO captures VALUES ('c', '00', 1, 'captures/00', '{}', 0, NULL, NULL);
             INSERT INTO jobs (id, capture_id, preset, overrides, device, priority, state, created_ms, total)
                 VALUES ('old', 'c', 'draft', '{}', 'auto', 3, 'succeeded', 7, 10),
                        ('new', 'c', 'draft', '{}', 'auto', 4, 'running', 8, 10);
             INSERT INTO models VALUES ('m', 'old', 'c', 5, '{}', 9, NULL);
             INSERT INTO events VALUES (1, 'old', 7, 'state', '{}');")
        .await
        .unwrap();
        let reject = "UPDATE jobs SET state = 'rejected' WHERE id = 'new'";
        assert!(run(reject).await.is_err(), "the schema before the migration refuses this state");
        let figures = MIGRATIONS.iter().find(|m| m.version == 5).unwrap();
        run(figures.sql.as_str()).await.unwrap();
        run(reject).await.unwrap();
        for refused in [
            "UPDATE jobs SET state = 'running' WHERE id = 'new'",
            "INSERT INTO jobs (id, capture_id, preset, overrides, device, priority, state, created_ms, total)
                 VALUES ('odd', 'c', 'draft', '{}', 'auto', 0, 'odd', 0, 1)",
            "DELETE FROM captures",
        ] {
            assert!(run(refused).await.is_err(), "{refused}");
        }
        let jobs: Vec<(String, i64, String, i64, String, Option<String>)> = sqlx::query_as(
            "SELECT id, priority, state, created_ms, quality_gate, figures FROM jobs ORDER BY created_ms",
        )
        .fetch_all(&pool)
        .await
        .unwrap();
        let row = |id: &str, priority, state: &str, at| {
            (id.to_owned(), priority, state.to_owned(), at, "{}".to_owned(), None)
        };
        assert_eq!(jobs, [row("old", 3, "succeeded", 7), row("new", 4, "rejected", 8)]);
        let sound: String = sqlx::query_scalar("PRAGMA integrity_check").fetch_one(&pool).await.unwrap();
        let models: i64 = sqlx::query_scalar("SELECT COUNT(*) FROM models").fetch_one(&pool).await.unwrap();
        assert_eq!((sound.as_str(), models), ("ok", 1));
    }

    #[tokio::test]
    async fn reader_connections_are_read_only() {
        let folder = tempfile::tempdir().unwrap();
        let database = DatabaseFile::open(folder.path()).await.unwrap();
        let refused = sql::query("DELETE FROM jobs").execute(database.readers()).await.unwrap_err();
        assert!(refused.to_string().contains("readonly"), "{refused}");
    }
}
