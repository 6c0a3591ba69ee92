//! Thumbnails of models and photographs, on disk within a bound: the same picture is not rendered twice, also after a restart.
//!
//! A file is named by its model and by the digest of its `ETag`. It begins with a hash of its name and its picture, so that one
//! that is damaged, cut off or exchanged is not served. Nothing is synced: what a crash costs is rendered anew.

use std::collections::HashSet;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use lru::LruCache;
use sha2::{Digest, Sha256};

use crate::store::make_private;

/// The folder, in the data directory.
const FOLDER: &str = "cache/thumbnails";
/// What a name begins with while its file is written.
const UNFINISHED: &str = ".unfinished-";
/// Length of the hash that a file begins with.
const HASH: usize = 32;
/// Disks store whole blocks: a file counts as a multiple of this.
const BLOCK: u64 = 4096;

/// The cache of one data directory. Clones share it.
#[derive(Clone)]
pub(super) struct ThumbnailCache(Arc<ThumbnailCacheInner>);

struct ThumbnailCacheInner {
    folder: PathBuf,
    /// Most bytes of all files; 0 for no cache.
    most: u64,
    files: Mutex<Files>,
}

/// What is there, by name.
struct Files {
    /// Bytes of each file, the one that was asked for longest ago first.
    lengths: LruCache<String, u64>,
    /// Bytes on disk.
    taken: u64,
}

impl ThumbnailCache {
    /// The cache of a data directory, of at most `most` bytes. What an earlier server left stays as far as it fits; with 0 nothing
    /// does. A folder that cannot be read is logged and counts as empty. Blocks.
    pub(super) fn open(data_dir: &Path, most: u64) -> Self {
        let folder = data_dir.join(FOLDER);
        let found = found(&folder).unwrap_or_else(|error| {
            tracing::warn!(%error, "cached thumbnails cannot be read");
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

    /// The picture of a model with this tag's digest, and counts whether there is one.
    pub(super) async fn get(&self, model: &str, digest: &str) -> Option<Vec<u8>> {
        let name = self.name(model, digest)?;
        let inner = self.0.clone();
        let found = tokio::task::spawn_blocking(move || inner.read(&name)).await.ok().flatten();
        let outcome = if found.is_some() { "hit" } else { "miss" };
        metrics::counter!("relume_thumbnail_cache_total", "outcome" => outcome).increment(1);
        found
    }

    /// Keeps a picture, in the place of those that were asked for longest ago. One that cannot be written is not kept.
    pub(super) async fn put(&self, model: &str, digest: &str, picture: Vec<u8>) {
        let Some(name) = self.name(model, digest) else { return };
        let inner = self.0.clone();
        let written = tokio::task::spawn_blocking(move || inner.write(&name, &picture)).await;
        if let Err(error) = written.unwrap_or_else(|error| Err(std::io::Error::other(error))) {
            tracing::debug!(%error, "a thumbnail was not cached");
        }
    }

    /// Removes the pictures of all models but these.
    pub(super) async fn keep_only(&self, models: HashSet<String>) {
        self.forget(move |model| !models.contains(model)).await;
    }

    /// Removes the pictures of a model.
    pub(super) async fn forget_all_of(&self, model: &str) {
        let gone = model.to_owned();
        self.forget(move |model| *model == gone).await;
    }

    /// Whether there is nothing to be removed.
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
            tracing::warn!(%error, "cached thumbnails were not removed");
        }
    }

    /// A file's name; `None` where nothing is cached, also for identifiers that this program does not give.
    fn name(&self, model: &str, digest: &str) -> Option<String> {
        (self.0.most > 0 && is_plain(model) && is_plain(digest)).then(|| format!("{model}.{digest}"))
    }
}

impl ThumbnailCacheInner {
    fn files(&self) -> std::sync::MutexGuard<'_, Files> {
        // Each change of it is one that cannot panic halfway.
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
    /// Counts a file as the one that was asked for last, and returns the names of those that have to go for it.
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

    /// Counts a file no more; its name if it was counted.
    fn take_one(&mut self, name: &str) -> Vec<String> {
        let taken = self.lengths.pop_entry(name);
        self.taken -= taken.as_ref().map_or(0, |(_, length)| on_disk(*length));
        taken.map(|(name, _)| name).into_iter().collect()
    }

    /// Counts the files of some models no more, and returns their names.
    fn take(&mut self, goes: impl Fn(&str) -> bool) -> Vec<String> {
        let of = |name: &str| name.split('.').next().is_some_and(&goes);
        let names: Vec<String> =
            self.lengths.iter().map(|(name, _)| name).filter(|n| of(n)).cloned().collect();
        names.iter().flat_map(|name| self.take_one(name)).collect()
    }
}

/// The files of a folder, the oldest first: time, name and length. What was not finished is removed; names that this program does
/// not give are left alone.
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

/// The picture in a file, if it is what was written under this name. It counts as used now, also for the next start.
fn read_checked(path: &Path, name: &str, length: u64) -> Option<Vec<u8>> {
    let mut file = File::open(path).ok()?;
    // A file that has grown is not read to its end.
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
        tracing::debug!(%error, name, "when a thumbnail was asked for is not remembered");
    }
    Some(picture)
}

fn hash(name: &str, picture: &[u8]) -> [u8; HASH] {
    Sha256::new().chain_update(name).chain_update(picture).finalize().into()
}

fn on_disk(length: u64) -> u64 {
    length.next_multiple_of(BLOCK)
}

/// Whether a text leads nowhere else as a part of a file's name.
fn is_plain(text: &str) -> bool {
    !text.is_empty() && text.len() <= 64 && text.bytes().all(|c| c.is_ascii_alphanumeric() || c == b'-')
}

fn remove(folder: &Path, names: &[String]) {
    for name in names {
        match std::fs::remove_file(folder.join(name)) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                tracing::warn!(%error, name, "a cached thumbnail cannot be removed");
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

    /// Dates a file back, as if it had not been asked for since.
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
        assert_eq!(names(data.path()), ["m.a", "m.c", "m.d"], "b was not asked for");
        assert!(cache.get("m", "b").await.is_none() && cache.get("n", "a").await.is_none());
        cache.put("m", "big", vec![0; 4 * BLOCK as usize]).await;
        assert_eq!(names(data.path()).len(), 3, "what never fits takes no other's place");
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
        assert_eq!(names(data.path()), ["m.d", "m.e", "not ours"], "the oldest of the folder went");
        ThumbnailCache::open(data.path(), BLOCK);
        assert_eq!(names(data.path()), ["m.e", "not ours"], "a smaller bound holds at once");
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
            assert!(!path.exists(), "it is in nobody's way");
        }
        for length in [0, HASH, whole.len() - 1, whole.len() + 1] {
            put().await;
            std::fs::write(&path, [&whole[..], b"!"].concat().get(..length).unwrap()).unwrap();
            assert_eq!(cache.get("m", "a").await, None, "{length} bytes");
        }
        put().await;
        cache.put("m", "b", b"a picture".to_vec()).await;
        std::fs::copy(&path, data.path().join(FOLDER).join("m.b")).unwrap();
        assert_eq!(cache.get("m", "b").await, None, "another's file under its name");
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
