//! A backup while a server works: a copy of the database at one moment, then the artifacts that this copy names. They never
//! change, but one that is not needed any more may go before it is copied: then another copy of the database is taken.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use sqlx::SqlitePool;

use crate::store::artifacts::{Remote, fetch_to};
use crate::store::backup::Backup;
use crate::store::backup::files::{CopiedFile, claim, clear, copy};
use crate::store::backup::manifest::{DATABASE, Manifest, artifact_path};
use crate::store::database::{self, Database, DatabaseFile, DatabaseUrl};
use crate::store::database_copy::copy_to_file;
use crate::store::hash::hash_file;
use crate::store::references::{Reference, references};
use crate::store::sql;
use crate::store::{ObjectStoreConfig, StoreError};

/// Copies of the database, until one is found whose artifacts are all there.
const MAX_DATABASE_COPIES: usize = 5;

/// Copies a data directory to a new folder, every artifact compared with its hash, with the database at `url` where that is not in
/// the directory: in a backup it is a file of SQLite in any case. A server may work meanwhile.
///
/// # Errors
/// [`StoreError::NotEmpty`] when there is something at `out`; [`StoreError::Damaged`] and [`StoreError::Missing`] when an artifact
/// is. What was made is removed then.
pub async fn backup(
    root: &Path,
    url: Option<&DatabaseUrl>,
    out: &Path,
    now_ms: i64,
) -> Result<Backup, StoreError> {
    backup_with(root, url, None, out, now_ms).await
}

/// As [`backup`], with artifacts from an object store where they are not in the directory, or not as they were stored.
///
/// # Errors
/// As [`backup`]; [`StoreError::ArtifactsUnreachable`].
pub async fn backup_with(
    root: &Path,
    url: Option<&DatabaseUrl>,
    artifacts: Option<&ObjectStoreConfig>,
    out: &Path,
    now_ms: i64,
) -> Result<Backup, StoreError> {
    if url.is_none() && !root.join(database::FILE).exists() {
        return Err(StoreError::NoDatabase(root.display().to_string()));
    }
    claim(out)?;
    let made = make(root, url, artifacts, out, now_ms).await;
    if made.is_err() {
        clear(out);
    }
    made
}

async fn make(
    root: &Path,
    url: Option<&DatabaseUrl>,
    artifacts: Option<&ObjectStoreConfig>,
    out: &Path,
    now_ms: i64,
) -> Result<Backup, StoreError> {
    let remote = artifacts.map(Remote::open).transpose()?;
    let source = match url {
        None => BackupSource::File(DatabaseFile::open_to_copy(root).await?),
        Some(_) => BackupSource::Server(Database::open(root, url).await?),
    };
    let copies = Copies { root: root.to_owned(), remote, out: out.to_owned(), files: HashMap::new() };
    let made = copy_all(&source, copies, now_ms).await;
    match source {
        BackupSource::File(pool) => pool.close().await,
        BackupSource::Server(database) => database.close().await,
    }
    made
}

/// The database that is copied.
enum BackupSource {
    File(SqlitePool),
    Server(Database),
}

async fn copy_all(source: &BackupSource, mut copies: Copies, now_ms: i64) -> Result<Backup, StoreError> {
    let file = copies.out.join(DATABASE);
    for _ in 1..MAX_DATABASE_COPIES {
        let named = copy_database(source, &file).await?;
        let missing = copies.add(named).await?;
        if missing.is_empty() {
            return finish(copies, &file, now_ms, 0).await;
        }
    }
    let named = copy_database(source, &file).await?;
    let missing = copies.add(named).await?;
    forget_checkpoints(&file, &missing).await?;
    finish(copies, &file, now_ms, missing.len()).await
}

/// Copies the database as it is at one moment, without unfinished uploads and exports; what that copy names.
async fn copy_database(source: &BackupSource, to: &Path) -> Result<Vec<Reference>, StoreError> {
    if to.exists() {
        std::fs::remove_file(to)?;
    }
    match source {
        BackupSource::File(pool) => {
            let path = to.to_str();
            let path = path.ok_or_else(|| std::io::Error::other("the path of a backup must be Unicode"))?;
            sql::query("VACUUM INTO $1").bind(path).execute(pool).await?;
        }
        BackupSource::Server(database) => copy_to_file(database, to).await?,
    }
    // What has arrived of unfinished uploads is not copied: their uploaders have it still.
    let copy = DatabaseFile::open_copy(to, false).await?;
    sql::query("DELETE FROM uploads").execute(&copy).await?;
    // Exports can be made again.
    sql::query("DELETE FROM exports").execute(&copy).await?;
    let named = references(&copy).await;
    copy.close().await;
    named
}

/// Jobs whose checkpoints were replaced too fast to be copied start over.
async fn forget_checkpoints(database: &Path, missing: &[String]) -> Result<(), StoreError> {
    let copy = DatabaseFile::open_copy(database, false).await?;
    for key in missing {
        let forget =
            "UPDATE jobs SET checkpoint = NULL, checkpoint_step = NULL, checkpoint_sha256 = NULL, step = 0
                      WHERE checkpoint = $1";
        if sql::query(forget).bind(key).execute(&copy).await? == 0 {
            return Err(StoreError::Missing(key.clone()));
        }
    }
    copy.close().await;
    Ok(())
}

async fn finish(
    mut copies: Copies,
    database: &Path,
    now_ms: i64,
    without_checkpoint: usize,
) -> Result<Backup, StoreError> {
    let copy = DatabaseFile::open_copy(database, true).await?;
    let named = references(&copy).await;
    copy.close().await;
    let mut files = Vec::new();
    for reference in named? {
        files.extend(copies.files.remove(&reference.artifact));
    }
    files.sort_by(|a, b| a.key.cmp(&b.key));
    let database = database.to_owned();
    let written = tokio::task::spawn_blocking(move || {
        // Copied for an earlier copy of the database, and not needed by the last one.
        for key in copies.files.into_keys() {
            std::fs::remove_file(artifact_path(&copies.out, &key))?;
        }
        let mut file = std::fs::File::open(&database)?;
        file.sync_all()?;
        let (bytes, sha256) = (file.metadata()?.len(), hash_file(&mut file)?);
        let created = jiff::Timestamp::from_millisecond(now_ms).unwrap_or_default().to_string();
        let database = CopiedFile { key: DATABASE.to_owned(), sha256, bytes };
        let made = Backup::of(&database, &files, without_checkpoint);
        Manifest::new(database::schema(), created, database, files).write(&copies.out)?;
        Ok(made)
    });
    written.await.map_err(std::io::Error::other)?
}

/// The artifacts that were copied, by key.
struct Copies {
    root: PathBuf,
    /// Where they are that are not here.
    remote: Option<Remote>,
    out: PathBuf,
    files: HashMap<String, CopiedFile>,
}

impl Copies {
    /// Copies what is named and not copied yet; gives the keys of those that are not there.
    async fn add(&mut self, mut named: Vec<Reference>) -> Result<Vec<String>, StoreError> {
        // Checkpoints are those that go soonest.
        named.sort_by_key(|reference| !reference.owner.starts_with("checkpoint"));
        let mut missing = Vec::new();
        for reference in named {
            if self.files.contains_key(&reference.artifact) {
                continue;
            }
            let found = match (self.copy_from_here(&reference).await, &self.remote) {
                (Err(StoreError::Damaged(_) | StoreError::Missing(_)), Some(remote)) => {
                    fetch(remote, &reference, &artifact_path(&self.out, &reference.artifact)).await
                }
                (found, _) => found,
            };
            match found {
                Ok(file) => drop(self.files.insert(reference.artifact, file)),
                Err(StoreError::Missing(_)) => missing.push(reference.artifact),
                Err(error) => return Err(error),
            }
        }
        Ok(missing)
    }

    async fn copy_from_here(&self, reference: &Reference) -> Result<CopiedFile, StoreError> {
        let key = reference.artifact.clone();
        let [from, to] = [&self.root, &self.out].map(|root| artifact_path(root, &key));
        let copied = tokio::task::spawn_blocking(move || match copy(&key, &from, &to) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Err(StoreError::Missing(key)),
            copied => Ok((copied?, to)),
        });
        let (file, to) = copied.await.map_err(std::io::Error::other)??;
        if is_other(reference, &file) {
            std::fs::remove_file(to)?;
            return Err(StoreError::Damaged(format!("artifacts/{}", file.key)));
        }
        Ok(file)
    }
}

/// Copies an artifact from the object store.
async fn fetch(remote: &Remote, reference: &Reference, to: &Path) -> Result<CopiedFile, StoreError> {
    let key = reference.artifact.clone();
    if let Some(folder) = to.parent() {
        std::fs::create_dir_all(folder)?;
    }
    let (sha256, bytes) = fetch_to(remote, &key, to).await?;
    let file = CopiedFile { key, sha256, bytes };
    if is_other(reference, &file) {
        return Err(StoreError::Damaged(file.key));
    }
    Ok(file)
}

fn is_other(reference: &Reference, file: &CopiedFile) -> bool {
    reference.sha256.as_ref().is_some_and(|expected| *expected != file.sha256)
}
