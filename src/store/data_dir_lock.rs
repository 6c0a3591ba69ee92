//! The lock of a data directory: an advisory lock that ends with its process. Only one server can hold it.

use std::fs::{File, TryLockError};
use std::io::{Read, Write};
use std::path::Path;

use crate::store::StoreError;
use crate::store::folder::make_private;

/// The lock is held until the server ends. Its holder knows that all local workers of earlier servers of this directory are dead,
/// so it can take over their leases immediately.
#[derive(Debug)]
pub struct DataDirLock {
    file: File,
}

impl DataDirLock {
    /// Locks the data directory. Creates it with access for its owner only if it does not exist.
    ///
    /// # Errors
    /// [`StoreError::Locked`] if another process holds the lock.
    pub fn acquire(root: &Path) -> Result<Self, StoreError> {
        make_private(root)?;
        let path = root.join("node.lock");
        let file = File::options().create(true).truncate(false).read(true).write(true).open(path)?;
        match file.try_lock() {
            Ok(()) => Ok(Self { file }),
            Err(TryLockError::WouldBlock) => Err(StoreError::Locked(root.display().to_string())),
            Err(TryLockError::Error(error)) => Err(error.into()),
        }
    }

    /// The name of the data directory, which identifies its server to other servers of the database. A directory without a name
    /// gets `fresh`.
    ///
    /// # Errors
    /// If the name cannot be read or written.
    pub fn name(&mut self, fresh: impl FnOnce() -> String) -> Result<String, StoreError> {
        let mut name = String::new();
        self.file.read_to_string(&mut name)?;
        if name.is_empty() {
            name = fresh();
            self.file.write_all(name.as_bytes())?;
        }
        Ok(name)
    }
}

#[cfg(test)]
mod tests {
    use std::fs::Permissions;
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_data_directory_has_one_owner_at_a_time() {
        let dir = tempfile::tempdir().unwrap();
        let first = DataDirLock::acquire(dir.path()).unwrap();
        assert!(matches!(DataDirLock::acquire(dir.path()), Err(StoreError::Locked(_))));
        drop(first);
        DataDirLock::acquire(dir.path()).unwrap();
    }

    #[test]
    fn a_data_directory_keeps_its_node_name() {
        let dir = tempfile::tempdir().unwrap();
        let named = |name: &str| DataDirLock::acquire(dir.path()).unwrap().name(|| name.to_owned()).unwrap();
        assert_eq!([named("first"), named("second")], ["first", "first"]);
    }

    #[test]
    fn a_new_data_directory_is_readable_only_by_its_owner() {
        let dir = tempfile::tempdir().unwrap();
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
        let data = dir.path().join("above/data");
        DataDirLock::acquire(&data).unwrap();
        assert_eq!([mode(&data), mode(&dir.path().join("above"))], [0o700; 2]);
        std::fs::set_permissions(&data, Permissions::from_mode(0o750)).unwrap();
        DataDirLock::acquire(&data).unwrap();
        assert_eq!(mode(&data), 0o750, "existing permissions are not changed");
    }
}
