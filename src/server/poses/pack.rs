//! Packs a folder with photographs and their poses into a tar.

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use axum::body::Bytes;
use futures::{Stream, stream};
use tokio::sync::mpsc;

use super::folder::LOG;

/// Bytes per chunk.
const CHUNK: usize = 1 << 18;
/// Maximum number of chunks in the channel.
const WAITING: usize = 4;
/// The parts of the folder that belong to the capture.
const PARTS: [&str; 3] = ["images", "masks", "sparse"];

/// The capture in `folder` as a tar: photographs, masks, sparse model and `log`. The same files give the same bytes.
pub(super) fn tar(folder: PathBuf, log: String) -> impl Stream<Item = io::Result<Bytes>> {
    let (send, receive) = mpsc::channel(WAITING);
    tokio::task::spawn_blocking(move || {
        let mut chunks = Chunks { send: send.clone(), buffer: Vec::new() };
        if let Err(error) = write(&folder, &log, &mut chunks).and_then(|()| chunks.flush()) {
            // The receiver may have ended.
            let _ = send.blocking_send(Err(error));
        }
    });
    stream::unfold(receive, async |mut receive| Some((receive.recv().await?, receive)))
}

fn write(folder: &Path, log: &str, to: &mut Chunks) -> io::Result<()> {
    let mut tar = tar::Builder::new(to);
    let mut add = |name: &str, size: u64, content: &mut dyn io::Read| {
        let mut header = tar::Header::new_gnu();
        header.set_size(size);
        header.set_mode(0o644);
        header.set_mtime(0);
        tar.append_data(&mut header, name, content)
    };
    for part in PARTS {
        for file in files_below(&folder.join(part))? {
            let name = file.strip_prefix(folder).map_err(io::Error::other)?;
            let mut content = File::open(&file)?;
            let size = content.metadata()?.len();
            add(&name.to_string_lossy(), size, &mut content)?;
        }
    }
    add(LOG, log.len() as u64, &mut log.as_bytes())?;
    tar.finish()
}

/// All files under an optional folder, sorted.
fn files_below(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let (mut files, mut open) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(folder) = open.pop().filter(|folder| folder.is_dir()) {
        for entry in std::fs::read_dir(&folder)? {
            let path = entry?.path();
            if path.is_dir() { open.push(path) } else { files.push(path) }
        }
    }
    files.sort();
    Ok(files)
}

/// Sends the written bytes in chunks.
struct Chunks {
    send: mpsc::Sender<io::Result<Bytes>>,
    buffer: Vec<u8>,
}

impl Write for Chunks {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.buffer.extend_from_slice(bytes);
        if self.buffer.len() >= CHUNK {
            self.flush()?;
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.buffer.is_empty() {
            return Ok(());
        }
        let chunk = Bytes::from(std::mem::take(&mut self.buffer));
        self.send.blocking_send(Ok(chunk)).map_err(|_| io::ErrorKind::BrokenPipe.into())
    }
}

#[cfg(test)]
mod tests {
    use futures::TryStreamExt;

    use super::*;

    #[tokio::test]
    async fn folder_is_packed_as_a_reproducible_tar_of_capture_files() {
        let folder = tempfile::TempDir::new().unwrap();
        for (name, bytes) in [
            ("images/b.jpg", 300_000),
            ("images/a/1.jpg", 3),
            ("sparse/0/x.bin", 5),
            ("colmap/database.db", 9),
        ] {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, vec![7; bytes]).unwrap();
        }
        let pack = async || {
            let chunks: Vec<Bytes> =
                tar(folder.path().to_owned(), "log".to_owned()).try_collect().await.unwrap();
            chunks.concat()
        };
        let bytes = pack().await;
        assert_eq!(bytes, pack().await, "the same files give the same bytes");
        let mut read = tar::Archive::new(bytes.as_slice());
        let names: Vec<_> = read
            .entries()
            .unwrap()
            .map(|entry| {
                let entry = entry.unwrap();
                (entry.path().unwrap().display().to_string(), entry.size())
            })
            .collect();
        let wanted = [("images/a/1.jpg", 3), ("images/b.jpg", 300_000), ("sparse/0/x.bin", 5), (LOG, 3)];
        assert_eq!(names, wanted.map(|(name, size)| (name.to_owned(), size)));
        std::fs::write(folder.path().join("images/b.jpg"), "other").unwrap();
        assert_ne!(bytes, pack().await, "the control");
    }
}
