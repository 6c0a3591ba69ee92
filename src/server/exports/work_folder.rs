//! The work folder of an export. Finished files stay in it, so that the next server can continue after a stop.

use std::io::BufWriter;
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::server::app::AppState;
use crate::server::exports::export_error::ExportError;
use crate::store::{ExportRecord, make_private};

/// File in the work folder with the hash of the model that the files show.
const MODEL_NOTE: &str = "model";
/// End of the names of files that are being written.
const PART: &str = ".part";

/// The work folder of an export of the model file with this hash, without unfinished files and without those of another model file.
pub(super) async fn prepared(
    app: &AppState,
    export: &ExportRecord,
    sha256: String,
) -> Result<PathBuf, ExportError> {
    let folder = app.store.export_folder(&export.id);
    let at = folder.clone();
    let clean = move || {
        keep_only_files_of(&at, &sha256)?;
        Ok(remove_parts(&at)?)
    };
    run_blocking(clean).await?;
    Ok(folder)
}

/// Runs blocking work.
pub(super) async fn run_blocking(
    work: impl FnOnce() -> Result<(), ExportError> + Send + 'static,
) -> Result<(), ExportError> {
    tokio::task::spawn_blocking(work).await.map_err(std::io::Error::other)?
}

/// Creates the work folder. Files of a model that was replaced since are removed from it.
fn keep_only_files_of(folder: &Path, sha256: &str) -> std::io::Result<()> {
    let note = folder.join(MODEL_NOTE);
    if std::fs::read_to_string(&note).is_ok_and(|noted| noted == sha256) {
        return Ok(());
    }
    match std::fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error),
        _ => make_private(folder)?,
    }
    std::fs::write(note, sha256)
}

/// Removes the unfinished files of an earlier attempt.
fn remove_parts(folder: &Path) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_name().to_string_lossy().ends_with(PART) {
            std::fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// Writes a file of the work folder atomically with `write`. The temporary file has a name of its own, because work on an earlier attempt
/// may still be ending.
///
/// # Errors
/// Those of `write` and of the file system.
pub(super) fn write_whole(
    folder: &Path,
    name: &Path,
    write: impl FnOnce(&mut BufWriter<NamedTempFile>) -> Result<(), ExportError>,
) -> Result<(), ExportError> {
    let part = tempfile::Builder::new().suffix(PART).tempfile_in(folder)?;
    let mut file = BufWriter::with_capacity(1 << 20, part);
    write(&mut file)?;
    let part = file.into_inner().map_err(std::io::IntoInnerError::into_error)?;
    part.as_file().sync_all()?;
    let path = folder.join(name);
    if let Some(parent) = path.parent() {
        std::fs::create_dir_all(parent)?;
    }
    part.persist(path).map_err(std::io::Error::from)?;
    Ok(())
}

/// Bytes of those of the files that exist.
pub(super) async fn bytes_there(folder: &Path, files: &[PathBuf]) -> u64 {
    let mut bytes = 0;
    for file in files {
        bytes += tokio::fs::metadata(folder.join(file)).await.map_or(0, |found| found.len());
    }
    bytes
}

/// Records that `done` parts of an export are complete, with `bytes` in their files, of which `before` were recorded.
///
/// # Errors
/// If the quota or the disk has no space, or the export is unwanted.
pub(super) async fn record(
    app: &AppState,
    export: &ExportRecord,
    done: usize,
    bytes: u64,
    before: u64,
) -> Result<(), ExportError> {
    app.store.admit_bytes_of(&export.tenant, bytes.saturating_sub(before)).await?;
    let done = i64::try_from(done).unwrap_or(i64::MAX);
    match app.store.record_export_progress(&export.id, done, bytes).await? {
        true => Ok(()),
        false => Err(ExportError::Unwanted),
    }
}
