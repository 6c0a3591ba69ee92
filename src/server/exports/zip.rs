//! Makes a zip of frames.

use std::fs::File;
use std::io::{BufWriter, ErrorKind, Write};
use std::path::Path;

use ::zip::CompressionMethod;
use ::zip::write::SimpleFileOptions;

/// Packs files of a folder in this order, without compression, because images are already compressed. Equal files give equal
/// zips. Blocks.
///
/// # Errors
/// When a file cannot be read or written, or `is_wanted` returns false.
pub(super) fn pack(
    folder: &Path,
    names: &[String],
    to: &Path,
    is_wanted: &dyn Fn() -> bool,
) -> std::io::Result<()> {
    let mut zip = ::zip::ZipWriter::new(BufWriter::new(File::create(to)?));
    for name in names {
        if !is_wanted() {
            return Err(ErrorKind::Interrupted.into());
        }
        let mut file = File::open(folder.join(name))?;
        let is_large = file.metadata()?.len() >= u64::from(u32::MAX);
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        zip.start_file(name.as_str(), options.large_file(is_large))?;
        std::io::copy(&mut file, &mut zip)?;
    }
    zip.finish()?.flush()
}
