//! Inspects a data directory without changes: the integrity of the database, and the existence and hashes of the referenced
//! artifacts.

use std::collections::HashSet;
use std::fs::File;
use std::path::Path;

use crate::store::artifacts::{Remote, is_never_uploaded};
use crate::store::database::{self, Database, ReadOnlyDatabase};
use crate::store::hash::hash_file;
use crate::store::references::{Reference, artifact_keys, is_artifact_name, references};
use crate::store::sql::{self, Pool};
use crate::store::{DatabaseUrl, ObjectStoreConfig, StoreError, ownership};

const SCHEMA: &str = "SELECT MAX(version) FROM _sqlx_migrations";

/// Result of an inspection.
#[derive(Debug, Clone, Default)]
pub struct Inspection {
    /// Schema of the database; `None` when there is no database.
    pub schema: Option<i64>,
    /// Number of artifacts that the database references.
    pub artifacts: usize,
    /// The faults, one sentence each.
    pub faults: Vec<String>,
    /// Keys of artifacts that the database does not reference. The next start of a server removes them.
    pub orphans: Vec<String>,
}

/// Inspects a data directory with its own database and reads every artifact. A server may run at the same time.
///
/// # Errors
/// When the directory cannot be read. Faults of its content are in the result.
pub async fn inspect(root: &Path) -> Result<Inspection, StoreError> {
    inspect_with(root, None, None).await
}

/// As [`inspect`], with the database at `url` and artifacts in an object store. All artifacts are read.
///
/// # Errors
/// As [`inspect`]; when the database cannot be reached; [`StoreError::ArtifactsUnreachable`].
pub async fn inspect_with(
    root: &Path,
    url: Option<&DatabaseUrl>,
    config: Option<&ObjectStoreConfig>,
) -> Result<Inspection, StoreError> {
    let mut found = Inspection::default();
    match ownership::check_before_migration(root, url).await {
        Err(error @ (StoreError::DatabaseMissing(_) | StoreError::DatabaseEmpty(_))) => {
            found.faults.push(error.to_string());
            return Ok(found);
        }
        // The inspection below names what is damaged.
        Err(StoreError::Database(_) | StoreError::DatabaseDamaged(_)) if url.is_none() => {}
        other => other?,
    }
    if url.is_none() && !root.join(database::FILE).exists() {
        return Ok(found);
    }
    let remote = config.map(Remote::open).transpose()?;
    match inspect_database(root, url, remote.as_ref(), &mut found).await {
        // An unreachable server is not a fault of its data.
        Err(error @ (StoreError::Database(_) | StoreError::DatabaseDamaged(_))) if url.is_none() => {
            found.faults.push(error.to_string());
        }
        other => other?,
    }
    Ok(found)
}

/// The codes of failed jobs of all tenants with their numbers, most frequent first; at most ten. Changes nothing.
///
/// # Errors
/// When the database cannot be read.
pub async fn failure_codes(root: &Path, url: Option<&DatabaseUrl>) -> Result<Vec<(String, i64)>, StoreError> {
    if url.is_none() && !root.join(database::FILE).exists() {
        return Ok(Vec::new());
    }
    let looked = Database::open_read_only(root, url).await?;
    let query = sql::query_as(
        "SELECT error_code, COUNT(*) FROM jobs WHERE state = 'failed' AND error_code IS NOT NULL
         GROUP BY error_code ORDER BY COUNT(*) DESC, error_code LIMIT 10",
    );
    let codes = query.fetch_all(&looked.pool).await;
    looked.pool.close().await;
    Ok(codes?)
}

async fn inspect_database(
    root: &Path,
    url: Option<&DatabaseUrl>,
    remote: Option<&Remote>,
    found: &mut Inspection,
) -> Result<(), StoreError> {
    let looked = Database::open_read_only(root, url).await?;
    let done = inspect_artifacts(&looked, root, remote, found).await;
    looked.pool.close().await;
    done
}

/// Inspects the database itself. Returns whether its schema is that of this program.
async fn inspect_schema(looked: &ReadOnlyDatabase, found: &mut Inspection) -> Result<bool, StoreError> {
    let schema = match &looked.pool {
        Pool::Sqlite(pool) => {
            let check = sqlx::query_scalar("PRAGMA integrity_check(10)");
            let integrity: Vec<String> = check.fetch_all(pool).await?;
            let damage = integrity.iter().filter(|line| *line != "ok");
            found.faults.extend(damage.map(|line| format!("the database is damaged: {line}")));
            Some(sqlx::query_scalar(SCHEMA).fetch_one(pool).await?)
        }
        Pool::Postgres(pool) => {
            let there = sqlx::query_scalar("SELECT to_regclass('_sqlx_migrations') IS NOT NULL");
            match there.fetch_one(pool).await? {
                true => sqlx::query_scalar(SCHEMA).fetch_one(pool).await?,
                false => None,
            }
        }
    };
    found.schema = schema;
    let Some(schema) = schema else { return Ok(false) };
    if schema > looked.known {
        let newer = StoreError::NewerDatabase { found: schema, known: looked.known };
        found.faults.push(newer.to_string());
    }
    // The next start of a server migrates an older database; until then its tables may lack columns of the queries.
    Ok(schema == looked.known)
}

async fn inspect_artifacts(
    looked: &ReadOnlyDatabase,
    root: &Path,
    remote: Option<&Remote>,
    found: &mut Inspection,
) -> Result<(), StoreError> {
    if !inspect_schema(looked, found).await? {
        return Ok(());
    }
    let mut named = references(&looked.pool).await?;
    found.artifacts = named.len();
    if let Some(remote) = remote {
        // Local files of these are copies, which are downloaded again if they are damaged.
        let (elsewhere, here) =
            named.into_iter().partition(|reference| !is_never_uploaded(&reference.artifact));
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

/// As [`compare`], for artifacts in the object store.
async fn compare_remote(
    remote: &Remote,
    named: Vec<Reference>,
    found: &mut Inspection,
) -> Result<(), StoreError> {
    let names: HashSet<&str> = named.iter().map(|reference| reference.artifact.as_str()).collect();
    let objects = remote.list("").await?.into_iter().map(|object| object.key);
    found.orphans = objects.filter(|key| is_artifact_name(key) && !names.contains(key.as_str())).collect();
    for Reference { artifact, sha256, owner } in &named {
        match (remote.hash(artifact).await, sha256) {
            (Ok(actual), Some(expected)) if actual != *expected => found.faults.push(format!(
                "{owner}: {artifact} is damaged in the object store: its bytes differ from those that were stored"
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

/// The faults of referenced artifacts, and the keys of unreferenced ones: of all, or of those that are never sent to the object
/// store.
fn compare(
    artifacts: &Path,
    named: &[Reference],
    is_all: bool,
) -> std::io::Result<(Vec<String>, Vec<String>)> {
    let faults = named.iter().filter_map(|reference| fault(artifacts, reference)).collect();
    let names: HashSet<&str> = named.iter().map(|reference| reference.artifact.as_str()).collect();
    let orphans = artifact_keys(artifacts)?
        .into_iter()
        .filter(|key| (is_all || is_never_uploaded(key)) && !names.contains(key.as_str()))
        .collect();
    Ok((faults, orphans))
}

fn fault(artifacts: &Path, Reference { artifact, sha256, owner }: &Reference) -> Option<String> {
    let hashed = File::open(artifacts.join(artifact)).and_then(|mut file| hash_file(&mut file));
    match (hashed, sha256) {
        (Ok(actual), Some(expected)) if actual != *expected => Some(format!(
            "{owner}: artifacts/{artifact} is damaged: its bytes differ from those that were stored"
        )),
        (Ok(_), _) => None,
        (Err(error), _) if error.kind() == std::io::ErrorKind::NotFound => {
            Some(format!("{owner}: artifacts/{artifact} is missing"))
        }
        (Err(error), _) => Some(format!("{owner}: artifacts/{artifact} cannot be read: {error}")),
    }
}
