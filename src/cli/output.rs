//! Atomic writing of output files.

use std::io::Write;
use std::path::Path;

/// [`write_whole`] with an error that names the file.
pub(super) fn write_named(path: &Path, bytes: &[u8]) -> Result<(), String> {
    write_whole(path, bytes).map_err(|error| format!("{}: {error}", path.display()))
}

/// Writes to a temporary file beside `path`, syncs and renames it, so that no reader sees a partial file.
pub(super) fn write_whole(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or_else(|| Path::new("."));
    std::fs::create_dir_all(folder)?;
    let mut builder = tempfile::Builder::new();
    builder.suffix(".relume-tmp");
    // The permissions follow the umask; those of a temporary file are private by default.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut file = builder.tempfile_in(folder)?;
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    file.persist(path)?;
    Ok(())
}
