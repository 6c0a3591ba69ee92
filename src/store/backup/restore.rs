//! Restores a data directory from a backup. The database is renamed to its final name last, so no server starts on the directory
//! before.

use std::collections::HashMap;
use std::path::Path;

use crate::store::artifacts::is_key;
use crate::store::backup::Backup;
use crate::store::backup::files::{CopiedFile, claim, clear, copy, sync_folders};
use crate::store::backup::manifest::{DATABASE, Manifest, artifact_path};
use crate::store::database::{self, DatabaseFile};
use crate::store::references::{names, references};
use crate::store::{DataDirLock, RESTORING, StoreError, sql};

/// Makes a data directory from a backup and compares each file with its hash. Blocks during the copy.
///
/// # Errors
/// [`StoreError::NoBackup`] if the folder is not a complete backup, [`StoreError::NotEmpty`] if `root` is not empty,
/// [`StoreError::Damaged`] or [`StoreError::Missing`] if a file of the backup is damaged or missing. The incomplete directory is
/// then removed.
pub async fn restore(backup: &Path, root: &Path) -> Result<Backup, StoreError> {
    let manifest = Manifest::read(backup)?;
    if manifest.schema > database::schema() {
        return Err(StoreError::NewerDatabase { found: manifest.schema, known: database::schema() });
    }
    let was_there = root.exists();
    claim(root)?;
    let lock = DataDirLock::acquire(root)?;
    let restored = fill(&manifest, backup, root).await;
    drop(lock);
    if restored.is_err() {
        clear(root);
        if !was_there {
            // A server would start on an empty folder as a new server without keys.
            std::fs::remove_dir(root).ok();
        }
    }
    restored
}

async fn fill(manifest: &Manifest, backup: &Path, root: &Path) -> Result<Backup, StoreError> {
    let unfinished = root.join(RESTORING);
    copy_checked(&manifest.database, &backup.join(DATABASE), &unfinished)?;
    for file in &manifest.artifacts {
        let [from, to] = [backup, root].map(|folder| artifact_path(folder, &file.key));
        copy_checked(file, &from, &to)?;
    }
    check(manifest, &unfinished).await?;
    sync_folders(root)?;
    std::fs::rename(&unfinished, root.join(database::FILE))?;
    std::fs::File::open(root)?.sync_all()?;
    Ok(Backup::of(&manifest.database, &manifest.artifacts, 0))
}

fn copy_checked(expected: &CopiedFile, from: &Path, to: &Path) -> Result<(), StoreError> {
    let copied = copy(&expected.key, from, to).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => StoreError::Missing(from.display().to_string()),
        _ => error.into(),
    })?;
    if copied != *expected {
        return Err(StoreError::Damaged(from.display().to_string()));
    }
    Ok(())
}

/// Checks the integrity of the database and the existence of the artifacts that it references.
async fn check(manifest: &Manifest, database: &Path) -> Result<(), StoreError> {
    let copy = DatabaseFile::open_copy(database, true).await?;
    let integrity: Vec<String> = sql::query_scalar("PRAGMA integrity_check(1)").fetch_all(&copy).await?;
    if let Some(damage) = integrity.into_iter().find(|line| line != "ok") {
        return Err(StoreError::DatabaseDamaged(damage));
    }
    let schema: i64 = sql::query_scalar("SELECT MAX(version) FROM _sqlx_migrations").fetch_one(&copy).await?;
    if schema != manifest.schema {
        return Err(StoreError::Damaged(DATABASE.to_owned()));
    }
    if let Some(name) = names(&copy).await?.into_iter().find(|name| !is_key(name)) {
        return Err(StoreError::Damaged(format!("{DATABASE} (it references {name:?})")));
    }
    // An older database lacks columns of this query. Its manifest was made by the version that has these columns.
    let named = if manifest.schema == database::schema() { references(&copy).await? } else { Vec::new() };
    copy.close().await;
    let there: HashMap<&str, &str> =
        manifest.artifacts.iter().map(|file| (file.key.as_str(), file.sha256.as_str())).collect();
    for reference in named {
        match there.get(reference.artifact.as_str()) {
            None => return Err(StoreError::Missing(format!("artifacts/{}", reference.artifact))),
            Some(found) if reference.sha256.as_deref().is_some_and(|expected| expected != *found) => {
                return Err(StoreError::Damaged(format!("artifacts/{}", reference.artifact)));
            }
            Some(_) => {}
        }
    }
    Ok(())
}
