//! The secret for signing URLs: a file in the data directory that only the server's user may read. It is read for each use, so
//! that a replacement takes effect immediately.

use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

/// Name of the file.
const FILE: &str = "signing.secret";
const BYTES: usize = 32;

/// The location of the secret.
#[derive(Debug, Clone)]
pub(super) struct SigningSecret {
    folder: PathBuf,
}

impl SigningSecret {
    /// The secret of a data directory.
    pub(super) fn of(data_dir: &Path) -> Self {
        Self { folder: data_dir.to_owned() }
    }

    /// The secret; `None` if no URL was signed yet.
    pub(super) async fn read(&self) -> std::io::Result<Option<Vec<u8>>> {
        match tokio::fs::read(self.folder.join(FILE)).await {
            Ok(secret) if secret.len() == BYTES => Ok(Some(secret)),
            Ok(_) => {
                Err(std::io::Error::other(format!("{FILE} does not have {BYTES} bytes: remove the file")))
            }
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// The secret, which is created if it does not exist.
    pub(super) async fn read_or_make(&self) -> std::io::Result<Vec<u8>> {
        if let Some(secret) = self.read().await? {
            return Ok(secret);
        }
        let folder = self.folder.clone();
        tokio::task::spawn_blocking(move || make(&folder, false)).await.map_err(std::io::Error::other)??;
        // If two are created concurrently, only one is kept.
        self.read().await?.ok_or_else(|| std::io::Error::other(format!("{FILE} was removed")))
    }
}

/// A digest of a secret, for places that must not reveal it.
pub(super) fn digest(secret: &[u8]) -> [u8; 32] {
    Sha256::digest(secret).into()
}

/// Replaces the secret of a data directory, which invalidates all signed URLs.
///
/// # Errors
/// When the file cannot be written.
pub fn rotate_signing_secret(data_dir: &Path) -> std::io::Result<()> {
    make(data_dir, true)
}

/// Writes a new secret atomically, in a file that only its owner can read. Blocks.
fn make(folder: &Path, replace: bool) -> std::io::Result<()> {
    let mut secret = [0u8; BYTES];
    getrandom::fill(&mut secret)?;
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    file.write_all(&secret)?;
    file.as_file().sync_all()?;
    let path = folder.join(FILE);
    match if replace { file.persist(path) } else { file.persist_noclobber(path) } {
        Err(refused) if refused.error.kind() != ErrorKind::AlreadyExists => Err(refused.error),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[tokio::test]
    async fn signing_secret_is_made_once_private_and_can_be_rotated() {
        let folder = tempfile::tempdir().unwrap();
        let secret = SigningSecret::of(folder.path());
        assert_eq!(secret.read().await.unwrap(), None);
        let (one, two) = tokio::join!(secret.read_or_make(), secret.read_or_make());
        let first = one.unwrap();
        assert_eq!(first, two.unwrap());
        let mode = std::fs::metadata(folder.path().join(FILE)).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        rotate_signing_secret(folder.path()).unwrap();
        assert_ne!(secret.read().await.unwrap(), Some(first));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
        std::fs::write(folder.path().join(FILE), "short").unwrap();
        assert!(secret.read().await.is_err());
    }
}
