//! A size-limited disk cache of thumbnails and photographs, which survives restarts.
//!
//! The name of a file consists of its model and the digest of its `ETag`. The file begins with a hash of its name and its image,
//! so that damaged, truncated or exchanged files are not served. Files are not synced: images that are lost in a crash are
//! rendered again.

use std::collections::HashSet;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use lru::LruCache;
use sha2::{Digest, Sha256};

use crate::store::make_private;

/// The folder in the data directory.
const FOLDER: &str = "cache/thumbnails";
/// Prefix of the name of an unfinished file.
const UNFINISHED: &str = ".unfinished-";
/// Length of the hash at the beginning of a file, bytes.
const HASH: usize = 32;
/// Block size of disks, bytes. The size of a file is rounded up to a multiple of it.
const BLOCK: u64 = 4096;

/// The cache of one data directory. Clones share it.
#[derive(Clone)]
pub(super) struct ThumbnailCache(Arc<ThumbnailCacheInner>);

struct ThumbnailCacheInner {
    folder: PathBuf,
    /// Size limit of all files, bytes; 0 disables the cache.
    most: u64,
    files: Mutex<Files>,
}

/// The files by name.
struct Files {
    /// Size of each file, bytes, ordered from the least to the most recently used.
    lengths: LruCache<String, u64>,
    /// Total size on disk, bytes.
    taken: u64,
}

impl ThumbnailCache {
    /// Opens the cache of a data directory with at most `most` bytes. Files of an earlier server are kept within the limit; with
    /// 0 they are removed. If the folder cannot be read, the error is logged and the cache is empty. Blocks.
    pub(super) fn open(data_dir: &Path, most: u64) -> Self {
        let folder = data_dir.join(FOLDER);
        let found = found(&folder).unwrap_or_else(|error| {
            tracing::warn!(%error, "cannot read the cached thumbnails");
            Vec::new()
        });
        let mut files = Files { lengths: LruCache::unbounded(), taken: 0 };
        let mut dropped = Vec::new();
        for (_, name, length) in found {
            dropped.extend(files.add(&name, length, most));
        }
        remove(&folder, &dropped);
        Self(Arc::new(ThumbnailCacheInner { folder, most, files: Mutex::new(files) }))
    }

    /// The image of a model with the digest of this tag. Records a hit or a miss.
    pub(super) async fn get(&self, model: &str, digest: &str) -> Option<Vec<u8>> {
        let name = self.name(model, digest)?;
        let inner = self.0.clone();
        let found = tokio::task::spawn_blocking(move || inner.read(&name)).await.ok().flatten();
        let outcome = if found.is_some() { "hit" } else { "miss" };
        metrics::counter!("relume_thumbnail_cache_total", "outcome" => outcome).increment(1);
        found
    }

    /// Stores an image and evicts the least recently used ones. Errors are logged.
    pub(super) async fn put(&self, model: &str, digest: &str, picture: Vec<u8>) {
        let Some(name) = self.name(model, digest) else { return };
        let inner = self.0.clone();
        let written = tokio::task::spawn_blocking(move || inner.write(&name, &picture)).await;
        if let Err(error) = written.unwrap_or_else(|error| Err(std::io::Error::other(error))) {
            tracing::debug!(%error, "a thumbnail was not cached");
        }
    }

    /// Removes the images of all models except these.
    pub(super) async fn keep_only(&self, models: HashSet<String>) {
        self.forget(move |model| !models.contains(model)).await;
    }

    /// Removes the images of a model.
    pub(super) async fn forget_all_of(&self, model: &str) {
        let gone = model.to_owned();
        self.forget(move |model| *model == gone).await;
    }

    /// Whether the cache is empty.
    pub(super) fn is_empty(&self) -> bool {
        self.0.files().lengths.is_empty()
    }

    async fn forget(&self, goes: impl Fn(&str) -> bool + Send + 'static) {
        let inner = self.0.clone();
        let work = move || {
            let names = inner.files().take(goes);
            remove(&inner.folder, &names);
        };
        if let Err(error) = tokio::task::spawn_blocking(work).await {
            tracing::warn!(%error, "cannot remove cached thumbnails");
        }
    }

    /// The name of a file; `None` if the cache is disabled or an identifier does not have the format of this program.
    fn name(&self, model: &str, digest: &str) -> Option<String> {
        (self.0.most > 0 && is_plain(model) && is_plain(digest)).then(|| format!("{model}.{digest}"))
    }
}

impl ThumbnailCacheInner {
    fn files(&self) -> std::sync::MutexGuard<'_, Files> {
        // No change of the map can panic halfway, so a poisoned lock is still valid.
        self.files.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn read(&self, name: &str) -> Option<Vec<u8>> {
        let length = *self.files().lengths.get(name)?;
        let read = read_checked(&self.folder.join(name), name, length);
        if read.is_none() {
            tracing::warn!(name, "a cached thumbnail is damaged");
            let names = self.files().take_one(name);
            remove(&self.folder, &names);
        }
        read
    }

    fn write(&self, name: &str, picture: &[u8]) -> std::io::Result<()> {
        let length = (HASH + picture.len()) as u64;
        if on_disk(length) > self.most {
            return Ok(());
        }
        make_private(&self.folder)?;
        let mut file = tempfile::Builder::new().prefix(UNFINISHED).tempfile_in(&self.folder)?;
        file.write_all(&hash(name, picture))?;
        file.write_all(picture)?;
        file.persist(self.folder.join(name))?;
        let dropped = self.files().add(name, length, self.most);
        remove(&self.folder, &dropped);
        Ok(())
    }
}

impl Files {
    /// Adds a file as the most recently used, and returns the names of the files to evict.
    fn add(&mut self, name: &str, length: u64, most: u64) -> Vec<String> {
        if let Some(before) = self.lengths.push(name.to_owned(), length) {
            self.taken -= on_disk(before.1);
        }
        self.taken += on_disk(length);
        let mut dropped = Vec::new();
        while self.taken > most
            && let Some((name, length)) = self.lengths.pop_lru()
        {
            self.taken -= on_disk(length);
            dropped.push(name);
        }
        dropped
    }

    /// Removes the entry of a file. Returns its name if it existed.
    fn take_one(&mut self, name: &str) -> Vec<String> {
        let taken = self.lengths.pop_entry(name);
        self.taken -= taken.as_ref().map_or(0, |(_, length)| on_disk(*length));
        taken.map(|(name, _)| name).into_iter().collect()
    }

    /// Removes the entries of some models, and returns the file names.
    fn take(&mut self, goes: impl Fn(&str) -> bool) -> Vec<String> {
        let of = |name: &str| name.split('.').next().is_some_and(&goes);
        let names: Vec<String> =
            self.lengths.iter().map(|(name, _)| name).filter(|n| of(n)).cloned().collect();
        names.iter().flat_map(|name| self.take_one(name)).collect()
    }
}

/// The files of a folder, the oldest first: time, name and length. Unfinished files are removed; files with other names are
/// ignored.
fn found(folder: &Path) -> std::io::Result<Vec<(SystemTime, String, u64)>> {
    let entries = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let mut found = Vec::new();
    for entry in entries {
        let entry = entry?;
        let (name, about) = (entry.file_name(), entry.metadata()?);
        let Some(name) = name.to_str().filter(|_| about.is_file()) else { continue };
        if name.starts_with(UNFINISHED) {
            remove(folder, &[name.to_owned()]);
        } else if name.split_once('.').is_some_and(|(model, digest)| is_plain(model) && is_plain(digest)) {
            found.push((about.modified()?, name.to_owned(), about.len()));
        }
    }
    found.sort();
    Ok(found)
}

/// The image in a file, if its hash is correct. Records its use, also for the next start.
fn read_checked(path: &Path, name: &str, length: u64) -> Option<Vec<u8>> {
    let mut file = File::open(path).ok()?;
    // A file that has grown is not read.
    if file.metadata().ok()?.len() != length {
        return None;
    }
    let (mut expected, mut picture) = ([0; HASH], Vec::new());
    file.read_exact(&mut expected).ok()?;
    file.read_to_end(&mut picture).ok()?;
    if hash(name, &picture) != expected {
        return None;
    }
    if let Err(error) = file.set_modified(SystemTime::now()) {
        tracing::debug!(%error, name, "cannot record the use of a thumbnail");
    }
    Some(picture)
}

fn hash(name: &str, picture: &[u8]) -> [u8; HASH] {
    Sha256::new().chain_update(name).chain_update(picture).finalize().into()
}

fn on_disk(length: u64) -> u64 {
    length.next_multiple_of(BLOCK)
}

/// Whether a text is safe as a part of a file name.
fn is_plain(text: &str) -> bool {
    !text.is_empty() && text.len() <= 64 && text.bytes().all(|c| c.is_ascii_alphanumeric() || c == b'-')
}

fn remove(folder: &Path, names: &[String]) {
    for name in names {
        match std::fs::remove_file(folder.join(name)) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                tracing::warn!(%error, name, "cannot remove a cached thumbnail");
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn names(data: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(data.join(FOLDER)).into_iter().flatten();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    /// Sets the time of a file back, as if it had not been used since.
    fn age(data: &Path, name: &str, hours: u64) {
        let file = File::open(data.join(FOLDER).join(name)).unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(3600 * hours)).unwrap();
    }

    #[tokio::test]
    async fn thumbnail_cache_evicts_least_recently_used_after_restarts() {
        let data = tempfile::tempdir().unwrap();
        let cache = ThumbnailCache::open(data.path(), 3 * BLOCK);
        for digest in ["a", "b", "c"] {
            cache.put("m", digest, digest.repeat(100).into_bytes()).await;
        }
        assert_eq!(cache.get("m", "a").await.unwrap(), [b'a'; 100]);
        cache.put("m", "d", vec![0; 10]).await;
        assert_eq!(names(data.path()), ["m.a", "m.c", "m.d"], "b was not requested");
        assert!(cache.get("m", "b").await.is_none() && cache.get("n", "a").await.is_none());
        cache.put("m", "big", vec![0; 4 * BLOCK as usize]).await;
        assert_eq!(names(data.path()).len(), 3, "an image that can never fit evicts nothing");
        cache.put("m", "two", vec![0; BLOCK as usize]).await;
        assert_eq!(names(data.path()), ["m.d", "m.two"], "a block and a hash are two blocks");

        age(data.path(), "m.d", 1);
        age(data.path(), "m.two", 2);
        std::fs::write(data.path().join(FOLDER).join(format!("{UNFINISHED}1")), "half").unwrap();
        std::fs::write(data.path().join(FOLDER).join("not ours"), "something").unwrap();
        let cache = ThumbnailCache::open(data.path(), 3 * BLOCK);
        assert_eq!(names(data.path()), ["m.d", "m.two", "not ours"]);
        assert!(cache.get("m", "d").await.is_some());
        cache.put("m", "e", vec![1]).await;
        assert_eq!(names(data.path()), ["m.d", "m.e", "not ours"], "the oldest file was evicted");
        ThumbnailCache::open(data.path(), BLOCK);
        assert_eq!(names(data.path()), ["m.e", "not ours"], "a smaller limit applies immediately");
        let off = ThumbnailCache::open(data.path(), 0);
        off.put("m", "f", vec![1]).await;
        assert_eq!(names(data.path()), ["not ours"]);
        assert!(off.get("m", "e").await.is_none());
    }

    #[tokio::test]
    async fn a_damaged_cached_thumbnail_is_not_served() {
        let data = tempfile::tempdir().unwrap();
        let cache = ThumbnailCache::open(data.path(), 1 << 20);
        let path = data.path().join(FOLDER).join("m.a");
        let put = async || {
            cache.put("m", "a", b"a picture".to_vec()).await;
            std::fs::read(&path).unwrap()
        };
        let whole = put().await;
        for at in [0, HASH - 1, HASH, whole.len() - 1] {
            let mut bytes = put().await;
            bytes[at] ^= 1;
            std::fs::write(&path, bytes).unwrap();
            assert_eq!(cache.get("m", "a").await, None, "byte {at}");
            assert!(!path.exists(), "the damaged file is removed");
        }
        for length in [0, HASH, whole.len() - 1, whole.len() + 1] {
            put().await;
            std::fs::write(&path, [&whole[..], b"!"].concat().get(..length).unwrap()).unwrap();
            assert_eq!(cache.get("m", "a").await, None, "{length} bytes");
        }
        put().await;
        cache.put("m", "b", b"a picture".to_vec()).await;
        std::fs::copy(&path, data.path().join(FOLDER).join("m.b")).unwrap();
        assert_eq!(cache.get("m", "b").await, None, "the file of another image under its name");
        assert_eq!(cache.get("m", "a").await.unwrap(), b"a picture", "the control");
    }

    #[tokio::test]
    async fn cached_thumbnails_of_deleted_models_are_removed() {
        let data = tempfile::tempdir().unwrap();
        let cache = ThumbnailCache::open(data.path(), 1 << 20);
        for model in ["m", "mm", "n"] {
            cache.put(model, "a", vec![1]).await;
        }
        cache.put("../../elsewhere", "a", vec![1]).await;
        cache.forget_all_of("m").await;
        assert_eq!(names(data.path()), ["mm.a", "n.a"]);
        cache.keep_only(["n".to_owned()].into()).await;
        assert_eq!(names(data.path()), ["n.a"]);
        assert!(!cache.is_empty() && cache.get("mm", "a").await.is_none());
    }

    #[tokio::test]
    async fn an_unusable_cache_folder_disables_the_cache() {
        let data = tempfile::tempdir().unwrap();
        std::fs::write(data.path().join("cache"), "a file").unwrap();
        let cache = ThumbnailCache::open(data.path(), 1 << 20);
        cache.put("m", "a", vec![1]).await;
        assert!(cache.is_empty() && cache.get("m", "a").await.is_none());
    }
}
