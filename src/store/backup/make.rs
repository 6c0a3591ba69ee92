//! Makes a backup while a server runs: a snapshot of the database, then the artifacts that the snapshot references. Artifacts
//! never change, but the server may remove one before it is copied. In this case another snapshot is made.

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
use crate::store::{ObjectStoreConfig, StoreError, sql};

/// Maximum number of snapshots, until all artifacts of one are available.
const MAX_DATABASE_COPIES: usize = 5;

/// Copies a data directory to a new folder and compares each artifact with its hash. The database is at `url`, or in the
/// directory. The backup contains it as a SQLite file in both cases. A server may run at the same time.
///
/// # Errors
/// [`StoreError::NotEmpty`] if `out` is not empty; [`StoreError::Damaged`] or [`StoreError::Missing`] if an artifact is damaged
/// or missing. The incomplete backup is then removed.
pub async fn backup(
    root: &Path,
    url: Option<&DatabaseUrl>,
    out: &Path,
    now_ms: i64,
) -> Result<Backup, StoreError> {
    backup_with(root, url, None, out, now_ms).await
}

/// As [`backup`]; downloads artifacts from an object store if they are missing in the directory or damaged.
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

/// The database to copy.
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

/// Copies a snapshot of the database without unfinished uploads and exports. Returns the artifacts that the copy references.
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
    // The data of unfinished uploads are not copied, because clients can send them again.
    let copy = DatabaseFile::open_copy(to, false).await?;
    sql::query("DELETE FROM uploads").execute(&copy).await?;
    // Exports can be made again.
    sql::query("DELETE FROM exports").execute(&copy).await?;
    let named = references(&copy).await;
    copy.close().await;
    named
}

/// Removes the checkpoints that were replaced before they could be copied. Their jobs restart from step 0.
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
        // These files belong to an earlier snapshot, and the last snapshot does not reference them.
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

/// The copied artifacts, by key.
struct Copies {
    root: PathBuf,
    /// The object store with artifacts that are not in the data directory.
    remote: Option<Remote>,
    out: PathBuf,
    files: HashMap<String, CopiedFile>,
}

impl Copies {
    /// Copies the referenced artifacts that are not copied yet. Returns the keys of those that do not exist.
    async fn add(&mut self, mut named: Vec<Reference>) -> Result<Vec<String>, StoreError> {
        // Checkpoints are replaced first, so they are copied first.
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
