//! Checks that the artifacts of a data directory belong to its database. A server that started on another or an empty database would
//! answer without keys and would move every artifact to the orphans folder.

use std::path::Path;
use std::time::{Duration, SystemTime};

use crate::store::database::{self, Database, DatabaseFile, DatabaseServer, DatabaseUrl};
use crate::store::references::{artifact_keys, names};
use crate::store::{RESTORING, StoreError, sql};

/// Whether the data directory has artifacts.
pub(super) fn has_artifacts(root: &Path) -> Result<bool, StoreError> {
    Ok(root.join(RESTORING).exists() || !artifact_keys(&root.join("artifacts"))?.is_empty())
}

/// Refuses a data directory with artifacts whose database is missing or has no tables. Moves and removes nothing.
///
/// # Errors
/// [`StoreError::DatabaseMissing`] and [`StoreError::DatabaseEmpty`]; when the database or the directory cannot be read.
pub(super) async fn check_before_migration(root: &Path, url: Option<&DatabaseUrl>) -> Result<(), StoreError> {
    if !has_artifacts(root)? {
        return Ok(());
    }
    let name = root.display().to_string();
    let schema = match url {
        None if !root.join(database::FILE).exists() => return Err(StoreError::DatabaseMissing(name)),
        None => DatabaseFile::schema_of(root).await?,
        Some(url) => DatabaseServer::schema_of(url).await?,
    };
    if schema == 0 { Err(StoreError::DatabaseEmpty(name)) } else { Ok(()) }
}

/// Refuses a database that has never named an artifact, beside artifacts that are older than the database. A server that was killed
/// during its first upload has left a younger one.
///
/// # Errors
/// [`StoreError::ForeignArtifacts`]; when the database or the directory cannot be read.
pub(super) async fn check_owner(root: &Path, database: &Database) -> Result<(), StoreError> {
    if !names(database.readers()).await?.is_empty() {
        return Ok(());
    }
    let artifacts = root.join("artifacts");
    let keys = artifact_keys(&artifacts)?;
    if keys.is_empty() {
        return Ok(());
    }
    // Both queries give whole seconds, rounded down.
    let created = match database {
        Database::File(_) => {
            "SELECT CAST(strftime('%s', MIN(installed_on)) AS INTEGER) FROM _sqlx_migrations"
        }
        Database::Server(_) => {
            "SELECT FLOOR(EXTRACT(EPOCH FROM MIN(installed_on)))::BIGINT FROM _sqlx_migrations"
        }
    };
    let created: i64 = sql::query_scalar(created).fetch_one(database.readers()).await?;
    let created = SystemTime::UNIX_EPOCH + Duration::from_secs(created.max(0).unsigned_abs());
    for key in keys {
        if artifacts.join(key).metadata()?.modified()? < created {
            return Err(StoreError::ForeignArtifacts(root.display().to_string()));
        }
    }
    Ok(())
}
