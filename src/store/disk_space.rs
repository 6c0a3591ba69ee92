//! Checks the free disk space, and keeps a reserve for writes on a full disk.
//!
//! A job whose checkpoint does not fit must record this in the database, which itself needs a few kilobytes. The reserve is a
//! file that is removed in this case and created again when there is disk space.

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;

use crate::store::StoreError;

/// Size of the reserve, bytes: enough for some dozens of small transactions.
const RESERVE: u64 = 1 << 20;
/// Minimum free space in addition to the reserve, bytes. With less the service cannot work.
const MIN_FREE_BYTES: u64 = 1 << 20;

/// The disk space of one data directory.
#[derive(Clone)]
pub struct DiskSpace {
    root: PathBuf,
    /// Bytes of the last write that did not fit; 0 if all writes fit.
    missing: Arc<AtomicU64>,
    /// True while the reserve is released.
    spent: Arc<AtomicBool>,
}

impl DiskSpace {
    pub(super) fn new(root: &Path) -> Self {
        Self { root: root.to_owned(), missing: Arc::default(), spent: Arc::default() }
    }

    /// Records that `bytes` did not fit. [`DiskSpace::check`] then requires this space.
    pub fn note_shortage(&self, bytes: u64) {
        self.missing.fetch_max(bytes.max(1), Ordering::SeqCst);
    }

    /// Clears the recorded shortage, when the write is no longer wanted.
    pub fn forget_shortage(&self) {
        self.missing.store(0, Ordering::SeqCst);
    }

    /// True after [`DiskSpace::note_shortage`] or [`DiskSpace::spend_reserve`] until a check succeeds.
    pub fn is_short(&self) -> bool {
        self.missing.load(Ordering::SeqCst) > 0 || self.spent.load(Ordering::SeqCst)
    }

    /// Releases the reserve for a small write that cannot wait. Returns false if it was already released.
    pub fn spend_reserve(&self) -> bool {
        self.spent.store(true, Ordering::SeqCst);
        match std::fs::remove_file(self.reserve()) {
            Ok(()) => true,
            Err(error) => {
                if error.kind() != ErrorKind::NotFound {
                    tracing::warn!(%error, "cannot release the disk reserve");
                }
                false
            }
        }
    }

    /// Restores the reserve if it is missing, and checks that the write that did not fit would fit now. Blocks for some file
    /// operations.
    ///
    /// # Errors
    /// [`StoreError::NoDiskSpace`] if the space is not sufficient; [`StoreError::File`] if the directory is not writable.
    pub fn check(&self) -> Result<(), StoreError> {
        let bytes = MIN_FREE_BYTES.max(self.missing.load(Ordering::SeqCst));
        let short = |error: std::io::Error| match StoreError::from(error) {
            StoreError::Full => StoreError::NoDiskSpace { bytes },
            other => other,
        };
        self.restore_reserve().map_err(short)?;
        let probe = tempfile::tempfile_in(&self.root).map_err(short)?;
        allocate(&probe, bytes).map_err(short)?;
        self.forget_shortage();
        Ok(())
    }

    fn reserve(&self) -> PathBuf {
        self.root.join("relume.db.reserve")
    }

    fn restore_reserve(&self) -> std::io::Result<()> {
        let path = self.reserve();
        if std::fs::metadata(&path).is_ok_and(|file| file.len() >= RESERVE) {
            self.spent.store(false, Ordering::SeqCst);
            return Ok(());
        }
        let file = File::options().create(true).truncate(false).write(true).open(&path)?;
        let made = allocate(&file, RESERVE).and_then(|()| file.sync_all());
        match made {
            Ok(()) => self.spent.store(false, Ordering::SeqCst),
            // An incomplete reserve would take space from pending writes.
            Err(_) => drop(std::fs::remove_file(&path)),
        }
        made
    }
}

/// Allocates blocks for `bytes` bytes of a file. A file system without allocation is assumed to have enough space.
fn allocate(file: &File, bytes: u64) -> std::io::Result<()> {
    match fallocate(file, FallocateFlags::empty(), 0, bytes) {
        Err(Errno::OPNOTSUPP | Errno::NOSYS | Errno::INVAL) => file.set_len(bytes),
        other => Ok(other?),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn disk_reserve_is_created_released_and_created_again() {
        let folder = tempfile::tempdir().unwrap();
        let disk_space = DiskSpace::new(folder.path());
        let blocks = || {
            let file = std::fs::metadata(disk_space.reserve()).ok()?;
            Some(std::os::unix::fs::MetadataExt::blocks(&file) * 512 >= RESERVE)
        };
        assert!(!disk_space.spend_reserve(), "the reserve does not exist yet");
        disk_space.check().unwrap();
        assert_eq!(
            (blocks(), disk_space.is_short()),
            (Some(true), false),
            "blocks are allocated, not only the length set"
        );
        assert!(disk_space.spend_reserve());
        assert_eq!((blocks(), disk_space.is_short()), (None, true));
        disk_space.check().unwrap();
        assert_eq!((blocks(), disk_space.is_short()), (Some(true), false));
        let files = std::fs::read_dir(folder.path()).unwrap().count();
        assert_eq!(files, 1, "a check leaves no other files");
    }

    #[test]
    fn disk_shortage_lasts_until_space_suffices_or_is_forgotten() {
        let folder = tempfile::tempdir().unwrap();
        let disk_space = DiskSpace::new(folder.path());
        // More than any disk has.
        disk_space.note_shortage(1 << 60);
        disk_space.note_shortage(7);
        let refused = disk_space.check().unwrap_err();
        assert!(matches!(refused, StoreError::NoDiskSpace { bytes } if bytes == 1 << 60), "{refused}");
        assert!(disk_space.is_short());
        disk_space.forget_shortage();
        disk_space.note_shortage(7);
        disk_space.check().unwrap();
        assert!(!disk_space.is_short());
    }
}
