//! Atomic writing of output files.

use std::fs::File;
use std::io::Write;
use std::path::Path;

/// Checks, without creating anything, that a file can be written at `path` later.
///
/// # Errors
/// Names the path, the reason and the remedy.
pub(super) fn check_writable(option: &str, path: &Path) -> Result<(), String> {
    let refused = |why: String| format!("{option} {}: {why}; name another path", path.display());
    if path.is_dir() {
        return Err(refused("is a folder, not a file".to_owned()));
    }
    let absolute = std::path::absolute(path).map_err(|error| refused(error.to_string()))?;
    let folder = absolute.ancestors().skip(1).find(|folder| folder.symlink_metadata().is_ok());
    let folder = folder.unwrap_or_else(|| Path::new("/"));
    tempfile::tempfile_in(folder)
        .map(drop)
        .map_err(|error| refused(format!("{} cannot be written: {error}", folder.display())))
}

/// [`write_whole`] with an error that names the file.
pub(super) fn write_named(path: &Path, bytes: &[u8]) -> Result<(), String> {
    write_whole(path, bytes).map_err(|error| format!("{}: {error}", path.display()))
}

/// Writes to a temporary file beside `path`, syncs and renames it, so that no reader sees a partial file.
pub(super) fn write_whole(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    write_by(path, |file| file.write_all(bytes))
}

/// As [`write_whole`], with the bytes that `write` writes into the file.
pub(super) fn write_by<E: From<std::io::Error>>(
    path: &Path,
    write: impl FnOnce(&mut File) -> Result<(), E>,
) -> Result<(), E> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or_else(|| Path::new("."));
    std::fs::create_dir_all(folder)?;
    let mut builder = tempfile::Builder::new();
    builder.suffix(".relume-tmp");
    // The permissions follow the umask; those of a temporary file are private by default.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut file = builder.tempfile_in(folder)?;
    write(file.as_file_mut())?;
    file.as_file().sync_all()?;
    file.persist(path).map_err(std::io::Error::from)?;
    Ok(())
}
