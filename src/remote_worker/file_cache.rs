//! A cache of downloaded files by hash, with a size limit.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use futures::{StreamExt, TryStreamExt};
use sha2::{Digest, Sha256};
use tokio::io::AsyncWriteExt;

use crate::store::hex;
use relume_client::{ClientError, Download};

/// Suffix of incomplete downloads.
const PART: &str = ".part";
/// Timeout without new bytes of a download.
const STALL: Duration = Duration::from_secs(60);

fn stalled() -> io::Error {
    io::Error::new(io::ErrorKind::TimedOut, "the download has stalled")
}

/// Why a file is not available.
#[derive(Debug, thiserror::Error)]
pub enum CacheError {
    /// The server or the connection failed.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// A file operation in the cache folder failed.
    #[error("the cache: {0}")]
    Io(#[from] io::Error),
    /// The received bytes do not match the hash of the file.
    #[error("the received bytes do not match the hash of the file")]
    WrongBytes,
}

/// A folder of downloaded files. Several processes may share it.
#[derive(Debug, Clone)]
pub struct FileCache {
    folder: PathBuf,
    /// Maximum total size of the files, bytes, without the last requested one.
    most: u64,
}

impl FileCache {
    /// Opens the folder. Creates it with access for its owner only if it does not exist.
    ///
    /// # Errors
    /// When the folder cannot be created.
    pub fn open(folder: &Path, most: u64) -> io::Result<Self> {
        crate::store::make_private(folder)?;
        Ok(Self { folder: folder.to_owned(), most })
    }

    /// The file of `download` and its hash. Downloads it unless an intact copy exists.
    ///
    /// # Errors
    /// See [`CacheError`]. Nothing of the file is left then.
    pub async fn keep(&self, download: Download) -> Result<(PathBuf, String), CacheError> {
        let sha256 = download.sha256();
        if sha256.len() != 64 || !sha256.chars().all(|c| c.is_ascii_hexdigit()) {
            return Err(CacheError::WrongBytes);
        }
        let path = self.folder.join(&sha256);
        let (there, expected) = (path.clone(), sha256.clone());
        let is_there = tokio::task::spawn_blocking(move || is_intact(&there, &expected)).await;
        if !is_there.unwrap_or(false) {
            self.receive(download, &path, &sha256).await?;
        }
        let (folder, kept, most) = (self.folder.clone(), path.clone(), self.most);
        let pruned = tokio::task::spawn_blocking(move || prune(&folder, &kept, most)).await;
        if let Ok(Err(error)) = pruned {
            tracing::warn!(%error, "cannot remove old files of the cache");
        }
        Ok((path, sha256))
    }

    async fn receive(&self, download: Download, path: &Path, sha256: &str) -> Result<(), CacheError> {
        let part = tempfile::Builder::new().prefix(sha256).suffix(PART).tempfile_in(&self.folder)?;
        let mut file = tokio::fs::File::from_std(part.reopen()?);
        let mut hasher = Sha256::new();
        let mut body = std::pin::pin!(download.bytes().await?.map_err(ClientError::from));
        while let Some(chunk) = tokio::time::timeout(STALL, body.next()).await.map_err(|_| stalled())? {
            let chunk = chunk?;
            hasher.update(&chunk);
            file.write_all(&chunk).await?;
        }
        file.sync_all().await?;
        if hex(&hasher.finalize()) != sha256 {
            return Err(CacheError::WrongBytes);
        }
        part.persist(path).map_err(|error| error.error)?;
        Ok(())
    }
}

/// Whether a file matches the hash in its name. Records its use; removes a damaged file.
fn is_intact(path: &Path, sha256: &str) -> bool {
    let Ok(mut file) = File::options().read(true).write(true).open(path) else { return false };
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 20];
    loop {
        match file.read(&mut buffer) {
            Ok(0) => break,
            Ok(count) => hasher.update(&buffer[..count]),
            Err(_) => return false,
        }
    }
    if hex(&hasher.finalize()) == sha256 {
        let _ = file.set_modified(SystemTime::now());
        return true;
    }
    tracing::warn!(path = %path.display(), "a cached file is damaged; it will be downloaded again");
    let _ = std::fs::remove_file(path);
    false
}

/// Removes the least recently used files until the limit is kept, and incomplete downloads older than a day.
fn prune(folder: &Path, kept: &Path, most: u64) -> io::Result<()> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let Ok(metadata) = entry.metadata() else { continue };
        let (path, used) = (entry.path(), metadata.modified()?);
        if path.to_string_lossy().ends_with(PART) {
            let age = SystemTime::now().duration_since(used).unwrap_or_default();
            if age.as_secs() > 24 * 3600 {
                std::fs::remove_file(path)?;
            }
        } else if metadata.is_file() && path != kept {
            files.push((used, path, metadata.len()));
        }
    }
    files.sort();
    let mut total: u64 = files.iter().map(|(_, _, bytes)| bytes).sum();
    for (_, path, bytes) in files {
        if total <= most {
            break;
        }
        std::fs::remove_file(path)?;
        total -= bytes;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prune_removes_the_oldest_files_but_keeps_the_one_in_use() {
        let dir = tempfile::tempdir().unwrap();
        let now = SystemTime::now();
        let make = |name: &str, age: u64| {
            let path = dir.path().join(name);
            std::fs::write(&path, [0; 10]).unwrap();
            let file = File::options().write(true).open(&path).unwrap();
            file.set_modified(now - Duration::from_secs(age)).unwrap();
            path
        };
        let (old, middle, young) = (make("a", 300), make("b", 200), make("c", 100));
        prune(dir.path(), &old, 10).unwrap();
        assert_eq!([old.exists(), middle.exists(), young.exists()], [true, false, true]);
    }

    #[test]
    fn a_damaged_cached_file_is_removed_and_reported_missing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("file");
        std::fs::write(&path, b"bytes").unwrap();
        let sha256 = hex(&Sha256::digest(b"bytes"));
        assert!(is_intact(&path, &sha256), "the control");
        std::fs::write(&path, b"bites").unwrap();
        assert!(!is_intact(&path, &sha256) && !path.exists());
    }
}
