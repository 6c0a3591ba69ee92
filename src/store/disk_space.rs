//! Disk space: whether there is any, and a reserve for what must be written when there is none.
//!
//! A job whose checkpoint does not fit must be able to say so in the database, which needs a few kilobytes itself. The reserve
//! is a file that is given up then, and made again once there is room.

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;

use crate::store::StoreError;

/// Bytes of the reserve: some dozens of small transactions.
const RESERVE: u64 = 1 << 20;
/// Least room, beside the reserve, with which the service counts as able to work.
const MIN_FREE_BYTES: u64 = 1 << 20;

/// The room of one data directory.
#[derive(Clone)]
pub struct DiskSpace {
    root: PathBuf,
    /// Bytes of the last write that did not fit; 0 when everything did.
    missing: Arc<AtomicU64>,
    /// True while the reserve is given up.
    spent: Arc<AtomicBool>,
}

impl DiskSpace {
    pub(super) fn new(root: &Path) -> Self {
        Self { root: root.to_owned(), missing: Arc::default(), spent: Arc::default() }
    }

    /// Remembers that `bytes` did not fit. [`DiskSpace::check`] then asks for that much.
    pub fn note_shortage(&self, bytes: u64) {
        self.missing.fetch_max(bytes.max(1), Ordering::SeqCst);
    }

    /// Forgets what did not fit, when nobody wants to write it any more.
    pub fn forget_shortage(&self) {
        self.missing.store(0, Ordering::SeqCst);
    }

    /// True after [`DiskSpace::note_shortage`] or [`DiskSpace::spend_reserve`] until a check passes.
    pub fn is_short(&self) -> bool {
        self.missing.load(Ordering::SeqCst) > 0 || self.spent.load(Ordering::SeqCst)
    }

    /// Gives the reserve up, for a small write that cannot wait. False when it was given up before.
    pub fn spend_reserve(&self) -> bool {
        self.spent.store(true, Ordering::SeqCst);
        match std::fs::remove_file(self.reserve()) {
            Ok(()) => true,
            Err(error) => {
                if error.kind() != ErrorKind::NotFound {
                    tracing::warn!(%error, "the reserve cannot be given up");
                }
                false
            }
        }
    }

    /// Makes the reserve again if it is gone, and looks whether what did not fit would fit now. Blocks for some file operations.
    ///
    /// # Errors
    /// [`StoreError::NoDiskSpace`] when it would not; [`StoreError::File`] when the directory cannot be written at all.
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
            // Half of it would take from those who need room now.
            Err(_) => drop(std::fs::remove_file(&path)),
        }
        made
    }
}

/// Takes blocks for `bytes` bytes of a file. A file system that cannot take blocks ahead of their bytes is believed to have room.
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
        assert!(!disk_space.spend_reserve(), "there is none yet");
        disk_space.check().unwrap();
        assert_eq!(
            (blocks(), disk_space.is_short()),
            (Some(true), false),
            "blocks are taken, not only a length"
        );
        assert!(disk_space.spend_reserve());
        assert_eq!((blocks(), disk_space.is_short()), (None, true));
        disk_space.check().unwrap();
        assert_eq!((blocks(), disk_space.is_short()), (Some(true), false));
        let files = std::fs::read_dir(folder.path()).unwrap().count();
        assert_eq!(files, 1, "a check leaves nothing else");
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
