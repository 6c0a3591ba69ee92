//! The artifacts that the database references, and the artifacts on disk.

use std::path::Path;

use sqlx::FromRow;
use uuid::Uuid;

use crate::store::StoreError;
use crate::store::exports::EXPORTS;
use crate::store::model_replacement::MODELS;
use crate::store::sql::{self, On};
use crate::store::uploads::UPLOADS;

/// An artifact that the database references.
#[derive(Debug, FromRow)]
pub(super) struct Reference {
    /// Its key.
    pub(super) artifact: String,
    /// Its hash, if stored.
    pub(super) sha256: Option<String>,
    /// Description of the row that references it.
    pub(super) owner: String,
}

/// All artifacts that the database references.
pub(super) async fn references<'c>(on: impl Into<On<'c>>) -> Result<Vec<Reference>, StoreError> {
    let query = sql::query_as(
        "SELECT artifact, sha256, 'capture ' || id AS owner FROM captures WHERE deleted_ms IS NULL
         UNION ALL SELECT artifact, sha256, 'environment ' || id FROM environments WHERE deleted_ms IS NULL
         UNION ALL SELECT artifact, sha256, 'model ' || model_id || ', ' || model_files.name FROM model_files
             JOIN models ON models.id = model_id WHERE deleted_ms IS NULL
         UNION ALL SELECT artifact, sha256, 'export ' || id FROM exports WHERE artifact IS NOT NULL AND deleted_ms IS NULL
         UNION ALL SELECT 'uploads/' || id, NULL, 'upload ' || id FROM uploads
         UNION ALL SELECT checkpoint, checkpoint_sha256, 'checkpoint of job ' || id FROM jobs
             WHERE checkpoint IS NOT NULL AND state IN ('queued', 'running', 'cancelling') AND deleted_ms IS NULL",
    );
    Ok(query.fetch_all(on).await?)
}

/// All values in the database that become paths, including those of deleted resources.
pub(super) async fn names<'c>(on: impl Into<On<'c>>) -> Result<Vec<String>, StoreError> {
    let query = sql::query_scalar(
        "SELECT artifact FROM captures UNION SELECT artifact FROM environments UNION SELECT artifact FROM model_files
         UNION SELECT checkpoint FROM jobs WHERE checkpoint IS NOT NULL UNION SELECT 'attempts/' || id FROM jobs
         UNION SELECT 'uploads/' || id FROM uploads UNION SELECT 'exports/' || id FROM exports
         UNION SELECT artifact FROM exports WHERE artifact IS NOT NULL",
    );
    Ok(query.fetch_all(on).await?)
}

/// The keys of all files under `artifacts` whose names have the format of this program. Blocks.
pub(super) fn artifact_keys(artifacts: &Path) -> std::io::Result<Vec<String>> {
    let mut keys = Vec::new();
    for family in ["captures", "environments", UPLOADS, EXPORTS] {
        files(&artifacts.join(family), family, 0, &mut keys)?;
    }
    // attempts/JOB/NUMBER/FILE
    files(&artifacts.join("attempts"), "attempts", 2, &mut keys)?;
    // models/MODEL/VERSION/FILE
    files(&artifacts.join(MODELS), MODELS, 2, &mut keys)?;
    keys.retain(|key| is_artifact_name(key));
    keys.sort();
    Ok(keys)
}

/// Whether a key has the format of this program.
pub(super) fn is_artifact_name(key: &str) -> bool {
    let parts: Vec<&str> = key.split('/').collect();
    match parts[..] {
        ["captures" | "environments", name] => is_hash(name),
        [UPLOADS | EXPORTS, name] => Uuid::parse_str(name).is_ok(),
        ["attempts" | MODELS, _, _, _] => true,
        _ => false,
    }
}

/// The keys of all files that attempts of a job wrote. Blocks.
pub(super) fn of_job(artifacts: &Path, job: &str) -> std::io::Result<Vec<String>> {
    let prefix = format!("attempts/{job}");
    let mut keys = Vec::new();
    files(&artifacts.join(&prefix), &prefix, 1, &mut keys)?;
    Ok(keys)
}

/// Adds the files `depth` levels below `folder` to `keys`; their keys begin with `prefix`.
fn files(folder: &Path, prefix: &str, depth: usize, keys: &mut Vec<String>) -> std::io::Result<()> {
    let entries = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        let entry = entry?;
        let (kind, name) = (entry.file_type()?, entry.file_name());
        let Some(name) = name.to_str() else { continue };
        let key = format!("{prefix}/{name}");
        if depth > 0 && kind.is_dir() {
            files(&entry.path(), &key, depth - 1, keys)?;
        } else if depth == 0 && kind.is_file() {
            keys.push(key);
        }
    }
    Ok(())
}

/// Whether a name is a sha256 in lower-case hex. Unfinished files have a suffix of `#` and a number.
fn is_hash(name: &str) -> bool {
    let name = name.split('#').next().unwrap_or_default();
    name.len() == 64 && name.bytes().all(|c| c.is_ascii_digit() || (b'a'..=b'f').contains(&c))
}
