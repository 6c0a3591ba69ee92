//! A look at a data directory that changes nothing: is the database sound, and is everything there that it names?

use std::collections::HashSet;
use std::fs::File;
use std::path::Path;

use sqlx::SqlitePool;

use crate::store::database::{self, DatabaseFile};
use crate::store::hash::hash_file;
use crate::store::references::{Reference, references, stored};
use crate::store::sql;
use crate::store::{StoreError, has_artifacts};

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
    let mut found = Inspection::default();
    if !root.join(database::FILE).exists() {
        if has_artifacts(root)? {
            found.faults.push(StoreError::DatabaseMissing(root.display().to_string()).to_string());
        }
        return Ok(found);
    }
    match look(root, &mut found).await {
        Err(error @ (StoreError::Database(_) | StoreError::DatabaseDamaged(_))) => {
            found.faults.push(error.to_string());
        }
        other => other?,
    }
    Ok(found)
}

async fn look(root: &Path, found: &mut Inspection) -> Result<(), StoreError> {
    let pool = DatabaseFile::open_to_look(root).await?;
    let looked = look_with(&pool, root, found).await;
    pool.close().await;
    looked
}

async fn look_with(pool: &SqlitePool, root: &Path, found: &mut Inspection) -> Result<(), StoreError> {
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
    let named = references(pool).await?;
    found.artifacts = named.len();
    let artifacts = root.join("artifacts");
    let looked = tokio::task::spawn_blocking(move || compare(&artifacts, &named)).await;
    let (faults, orphans) = looked.map_err(std::io::Error::other)??;
    found.faults.extend(faults);
    found.orphans = orphans;
    Ok(())
}

/// What is wrong with the artifacts that are named, and those that are not named.
fn compare(artifacts: &Path, named: &[Reference]) -> std::io::Result<(Vec<String>, Vec<String>)> {
    let faults = named.iter().filter_map(|reference| fault(artifacts, reference)).collect();
    let names: HashSet<&str> = named.iter().map(|reference| reference.artifact.as_str()).collect();
    let orphans = stored(artifacts)?.into_iter().filter(|key| !names.contains(key.as_str())).collect();
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
