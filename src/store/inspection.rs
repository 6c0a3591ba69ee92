//! A look at a data directory that changes nothing: is the database sound, and is everything there that it names?

use std::collections::HashSet;
use std::fs::File;
use std::path::Path;

use sqlx::SqlitePool;

use crate::store::artifacts::{Remote, stays_here};
use crate::store::database::{self, DatabaseFile};
use crate::store::hash::hash_file;
use crate::store::references::{Reference, is_ours, references, stored};
use crate::store::sql;
use crate::store::{ArtifactsPlace, StoreError, has_artifacts};

/// What a look at a data directory found.
#[derive(Debug, Clone, Default)]
pub struct Inspection {
    /// Schema of the database; `None` when there is no database.
    pub schema: Option<i64>,
    /// Artifacts that the database names.
    pub artifacts: usize,
    /// What is wrong, a sentence each.
    pub faults: Vec<String>,
    /// Keys of artifacts that the database does not name; the next start of a server takes them away.
    pub orphans: Vec<String>,
}

/// Looks at a data directory, reading every artifact. A server may run on it meanwhile.
///
/// # Errors
/// When the directory cannot be read; what is wrong with its content is in the answer.
pub async fn inspect(root: &Path) -> Result<Inspection, StoreError> {
    inspect_all(root, None).await
}

/// As [`inspect`], with artifacts in an object store: all of them are read.
///
/// # Errors
/// As [`inspect`]; [`StoreError::ArtifactsUnreachable`].
pub async fn inspect_with(root: &Path, place: &ArtifactsPlace) -> Result<Inspection, StoreError> {
    inspect_all(root, Some(Remote::open(place)?)).await
}

async fn inspect_all(root: &Path, remote: Option<Remote>) -> Result<Inspection, StoreError> {
    let mut found = Inspection::default();
    if !root.join(database::FILE).exists() {
        if has_artifacts(root)? {
            found.faults.push(StoreError::DatabaseMissing(root.display().to_string()).to_string());
        }
        return Ok(found);
    }
    match look(root, remote.as_ref(), &mut found).await {
        Err(error @ (StoreError::Database(_) | StoreError::DatabaseDamaged(_))) => {
            found.faults.push(error.to_string());
        }
        other => other?,
    }
    Ok(found)
}

async fn look(root: &Path, remote: Option<&Remote>, found: &mut Inspection) -> Result<(), StoreError> {
    let pool = DatabaseFile::open_to_look(root).await?;
    let looked = look_with(&pool, root, remote, found).await;
    pool.close().await;
    looked
}

async fn look_with(
    pool: &SqlitePool,
    root: &Path,
    remote: Option<&Remote>,
    found: &mut Inspection,
) -> Result<(), StoreError> {
    let integrity: Vec<String> = sql::query_scalar("PRAGMA integrity_check(10)").fetch_all(pool).await?;
    let damage = integrity.iter().filter(|line| *line != "ok");
    found.faults.extend(damage.map(|line| format!("the database is damaged: {line}")));
    let schema: i64 = sql::query_scalar("SELECT MAX(version) FROM _sqlx_migrations").fetch_one(pool).await?;
    found.schema = Some(schema);
    if schema > database::schema() {
        let newer = StoreError::NewerDatabase { found: schema, known: database::schema() };
        found.faults.push(newer.to_string());
        return Ok(());
    }
    if schema < database::schema() {
        // The next start of a server brings it up to date; its tables may lack what is asked for here.
        return Ok(());
    }
    let mut named = references(pool).await?;
    found.artifacts = named.len();
    if let Some(remote) = remote {
        // What is here of it is a copy, which is fetched anew when it is damaged.
        let (elsewhere, here) = named.into_iter().partition(|reference| !stays_here(&reference.artifact));
        named = here;
        compare_remote(remote, elsewhere, found).await?;
    }
    let is_all = remote.is_none();
    let artifacts = root.join("artifacts");
    let looked = tokio::task::spawn_blocking(move || compare(&artifacts, &named, is_all)).await;
    let (faults, orphans) = looked.map_err(std::io::Error::other)??;
    found.faults.extend(faults);
    found.orphans.extend(orphans);
    Ok(())
}

/// As [`compare`], in the object store.
async fn compare_remote(
    remote: &Remote,
    named: Vec<Reference>,
    found: &mut Inspection,
) -> Result<(), StoreError> {
    let names: HashSet<&str> = named.iter().map(|reference| reference.artifact.as_str()).collect();
    let objects = remote.list("").await?.into_iter().map(|object| object.key);
    found.orphans = objects.filter(|key| is_ours(key) && !names.contains(key.as_str())).collect();
    for Reference { artifact, sha256, owner } in &named {
        match (remote.hash(artifact).await, sha256) {
            (Ok(actual), Some(expected)) if actual != *expected => found.faults.push(format!(
                "{owner}: {artifact} is damaged in the object store: its bytes are not those that were stored"
            )),
            (Ok(_), _) => {}
            (Err(StoreError::Missing(_)), _) => {
                found.faults.push(format!("{owner}: {artifact} is missing in the object store"));
            }
            (Err(error), _) => return Err(error),
        }
    }
    Ok(())
}

/// What is wrong with the artifacts that are named, and those that are not named: of all, or of those that never leave this machine.
fn compare(
    artifacts: &Path,
    named: &[Reference],
    is_all: bool,
) -> std::io::Result<(Vec<String>, Vec<String>)> {
    let faults = named.iter().filter_map(|reference| fault(artifacts, reference)).collect();
    let names: HashSet<&str> = named.iter().map(|reference| reference.artifact.as_str()).collect();
    let orphans = stored(artifacts)?
        .into_iter()
        .filter(|key| (is_all || stays_here(key)) && !names.contains(key.as_str()))
        .collect();
    Ok((faults, orphans))
}

fn fault(artifacts: &Path, Reference { artifact, sha256, owner }: &Reference) -> Option<String> {
    let hashed = File::open(artifacts.join(artifact)).and_then(|mut file| hash_file(&mut file));
    match (hashed, sha256) {
        (Ok(actual), Some(expected)) if actual != *expected => Some(format!(
            "{owner}: artifacts/{artifact} is damaged: its bytes are not those that were stored"
        )),
        (Ok(_), _) => None,
        (Err(error), _) if error.kind() == std::io::ErrorKind::NotFound => {
            Some(format!("{owner}: artifacts/{artifact} is missing"))
        }
        (Err(error), _) => Some(format!("{owner}: artifacts/{artifact} cannot be read: {error}")),
    }
}
