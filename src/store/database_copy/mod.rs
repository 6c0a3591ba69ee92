//! Copies a snapshot of a database into an empty database and compares all rows before the commit.

mod row;
mod tables;

use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::store::database::{self, Database, DatabaseUrl};
use crate::store::database_copy::row::{ColumnValue, ReadColumns};
use crate::store::database_copy::tables::{TABLES, TableSpec};
use crate::store::sql::{self, On, Sql, Tx};
use crate::store::{DataDirLock, StoreError};

/// Rows per batch.
const BATCH_ROWS: i64 = 2000;

/// The source or the destination of a copy.
#[derive(Debug, Clone)]
pub enum DatabaseLocation {
    /// The SQLite file in a data directory.
    DataDir(PathBuf),
    /// A PostgreSQL database.
    Url(DatabaseUrl),
}

impl FromStr for DatabaseLocation {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text.contains("://") {
            return text.parse().map(Self::Url);
        }
        if text.is_empty() { Err("must not be empty".to_owned()) } else { Ok(Self::DataDir(text.into())) }
    }
}

/// The result of copying one table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CopiedTable {
    /// Name of the table.
    pub name: &'static str,
    /// Number of its rows.
    pub rows: usize,
}

/// Copies all rows of `from` to `to` in one transaction. `to` must be empty, and no server may run on either database. Files are
/// not changed: a server on `to` needs the same data directory.
///
/// # Errors
/// [`StoreError::NoDatabase`], [`StoreError::Locked`] or [`StoreError::DatabaseLocked`] if `from` or `to` cannot be used;
/// [`StoreError::DatabaseNotEmpty`] if `to` has rows; [`StoreError::CopyDiffers`] if a copied row differs. When a database fails.
pub async fn copy_database(
    from: &DatabaseLocation,
    to: &DatabaseLocation,
) -> Result<Vec<CopiedTable>, StoreError> {
    if let DatabaseLocation::DataDir(root) = from
        && !root.join(database::FILE).exists()
    {
        return Err(StoreError::NoDatabase(root.display().to_string()));
    }
    let (source, _source_lock) = open(from).await?;
    let (target, _target_lock) = open(to).await?;
    let copied = copy_between(&source, &target).await;
    source.close().await;
    target.close().await;
    copied
}

/// Copies a snapshot of a database to a new SQLite file. Servers may use the database at the same time.
pub(super) async fn copy_to_file(source: &Database, file: &Path) -> Result<(), StoreError> {
    let target = Database::create_file(file).await?;
    let copied = copy_between(source, &target).await;
    target.close().await;
    copied.map(drop)
}

/// Opens a database on which no server runs, and keeps servers from starting on it.
async fn open(place: &DatabaseLocation) -> Result<(Database, impl Sized + use<>), StoreError> {
    match place {
        DatabaseLocation::DataDir(root) => {
            let lock = DataDirLock::acquire(root)?;
            Ok((Database::open(root, None).await?, (Some(lock), None)))
        }
        DatabaseLocation::Url(url) => {
            let database = Database::open(Path::new(""), Some(url)).await?;
            let lock = database.lock().await?;
            Ok((database, (None, Some(lock))))
        }
    }
}

async fn copy_between(source: &Database, target: &Database) -> Result<Vec<CopiedTable>, StoreError> {
    let mut source = source.snapshot().await?;
    let mut tx = target.write().await?;
    for table in TABLES {
        let any = Sql::composed(format!("SELECT EXISTS (SELECT 1 FROM {})", table.name));
        if sql::query_scalar(any).fetch_one(&mut tx).await? {
            return Err(StoreError::DatabaseNotEmpty(table.name));
        }
    }
    // A row may refer to a later row of the same table.
    let later = Sql::each("PRAGMA defer_foreign_keys = ON", "SET CONSTRAINTS ALL DEFERRED");
    sql::query(later).execute(&mut tx).await?;
    let mut copied = Vec::new();
    for table in TABLES {
        let rows = copy(table, &mut source, &mut tx).await?;
        copied.push(CopiedTable { name: table.name, rows });
    }
    for table in TABLES {
        compare(table, &mut source, &mut tx).await?;
    }
    tx.commit().await?;
    Ok(copied)
}

/// Copies the rows of a table and returns their number.
async fn copy(table: &TableSpec, source: &mut Tx, tx: &mut Tx) -> Result<usize, StoreError> {
    let names: Vec<_> = table.columns.iter().map(|(name, _)| *name).collect();
    let places: Vec<_> = (1..=names.len()).map(|number| format!("${number}")).collect();
    let insert = format!("INSERT INTO {} ({}) VALUES ({})", table.name, names.join(", "), places.join(", "));
    let insert = Sql::composed(insert);
    let mut count = 0;
    loop {
        let rows = part(table, count, &mut *source).await?;
        if rows.is_empty() {
            break;
        }
        for row in &rows {
            let query = row.iter().fold(sql::query(insert.clone()), |query, field| field.bound(query));
            query.execute(&mut *tx).await?;
        }
        count += rows.len();
    }
    if table.is_numbered {
        let number = format!(
            "SELECT setval(pg_get_serial_sequence('{0}', 'seq'), COALESCE(MAX(seq), 1), MAX(seq) IS NOT NULL) FROM {0}",
            table.name
        );
        // SQLite continues from the largest number automatically.
        if matches!(tx, Tx::Postgres(..)) {
            sql::query(Sql::composed(number)).execute(&mut *tx).await?;
        }
    }
    Ok(count)
}

/// Compares the copied rows of a table with the originals.
async fn compare(table: &TableSpec, source: &mut Tx, tx: &mut Tx) -> Result<(), StoreError> {
    let mut count = 0;
    loop {
        let expected = part(table, count, &mut *source).await?;
        let found = part(table, count, &mut *tx).await?;
        let differs = expected.iter().zip(&found).position(|(expected, found)| !same(expected, found));
        if let Some(row) = differs.or_else(|| (expected.len() != found.len()).then_some(expected.len())) {
            return Err(StoreError::CopyDiffers { table: table.name, row: count + row });
        }
        if expected.is_empty() {
            return Ok(());
        }
        count += expected.len();
    }
}

/// One batch of rows of a table, after the first `skipped`.
async fn part<'c>(
    table: &TableSpec,
    skipped: usize,
    on: impl Into<On<'c>>,
) -> Result<Vec<Vec<ColumnValue>>, StoreError> {
    let names: Vec<_> = table.columns.iter().map(|(name, _)| *name).collect();
    let select = format!(
        "SELECT {} FROM {} ORDER BY {} LIMIT $1 OFFSET $2",
        names.join(", "),
        table.name,
        table.order
    );
    let query =
        sql::query(Sql::composed(select)).bind(BATCH_ROWS).bind(i64::try_from(skipped).unwrap_or(i64::MAX));
    let columns = table.columns;
    Ok(query.fetch_rows(on, |row| row.fields(columns), |row| row.fields(columns)).await?)
}

fn same(expected: &[ColumnValue], found: &[ColumnValue]) -> bool {
    expected.len() == found.len() && expected.iter().zip(found).all(|(a, b)| a.is_same(b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn table_list_matches_the_sqlite_schema() {
        let folder = tempfile::tempdir().unwrap();
        let database = Database::open(folder.path(), None).await.unwrap();
        let query =
            "SELECT m.name || '.' || c.name FROM sqlite_master AS m JOIN pragma_table_info(m.name) AS c
                     WHERE m.type = 'table' AND m.name NOT LIKE 'sqlite_%' AND m.name <> '_sqlx_migrations'";
        let mut found: Vec<String> = sql::query_scalar(query).fetch_all(database.readers()).await.unwrap();
        found.sort();
        assert_eq!(found, listed());
    }

    #[tokio::test]
    #[ignore = "needs PostgreSQL: .ci/postgres"]
    async fn table_list_matches_the_schema_on_postgres() {
        let server: DatabaseUrl = std::env::var("RELUME_TEST_POSTGRES").unwrap().parse().unwrap();
        let url = server.sibling("relume_tables").await.unwrap();
        let database = Database::open(Path::new(""), Some(&url)).await.unwrap();
        let query = "SELECT table_name || '.' || column_name FROM information_schema.columns
                     WHERE table_schema = 'public' AND table_name <> '_sqlx_migrations'";
        let mut found: Vec<String> = sql::query_scalar(query).fetch_all(database.readers()).await.unwrap();
        found.sort();
        assert_eq!(found, listed());
    }

    fn listed() -> Vec<String> {
        let columns = |table: &TableSpec| {
            table.columns.iter().map(|(column, _)| format!("{}.{column}", table.name)).collect::<Vec<_>>()
        };
        let mut listed: Vec<_> = TABLES.iter().flat_map(columns).collect();
        listed.sort();
        listed
    }
}
