//! Forms of single files, e.g. photographs and their `transforms.json`. They are packed into a tar while they are received.

use std::io::{self, SeekFrom};
use std::path::PathBuf;

use axum::body::Bytes;
use axum::extract::Multipart;
use axum::extract::multipart::{Field, MultipartError};
use futures::{Stream, TryStreamExt, stream};
use tokio::io::{AsyncReadExt, AsyncSeekExt, AsyncWriteExt};

use crate::server::app::AppState;
use crate::server::caller::Caller;
use crate::server::extract::{STALLED, is_too_slow};
use crate::server::problem::Problem;
use crate::store::{StagedUpload, StoreError};

/// Name of the form fields.
pub(super) const FIELD: &str = "files";
/// Size of a tar record, bytes.
const RECORD: usize = 512;
/// Maximum bytes read from a file at once.
const CHUNK: usize = 1 << 18;

/// Maximum bytes of the path of a file.
const MAX_NAME_BYTES: usize = 1024;

/// Why a form cannot be packed.
#[derive(Debug, thiserror::Error)]
enum FormError {
    #[error("{}", .0.body_text())]
    Form(#[from] MultipartError),
    #[error(transparent)]
    Disk(#[from] io::Error),
    #[error("{detail}")]
    File { pointer: String, detail: String },
    #[error("{name}: exceeds the maximum file size of {limit} bytes")]
    TooLarge { name: String, limit: u64 },
}

impl FormError {
    fn problem(self, caller: &Caller) -> Problem {
        match self {
            Self::Form(error) if is_too_slow(&error) => Problem::timeout(STALLED),
            Self::Form(error) => Problem::malformed_form(error.body_text()),
            Self::Disk(error) if error.kind() == io::ErrorKind::StorageFull => {
                caller.problem_for(StoreError::Full)
            }
            Self::Disk(error) => Problem::storage_failed(error),
            Self::File { pointer, detail } => Problem::invalid_field(pointer, detail),
            Self::TooLarge { limit, .. } => Problem::too_large(limit).detail(self.to_string()),
        }
    }
}

/// A file of the form, on disk without a name, so that it is removed when this is dropped or the server is killed.
pub(super) struct Spooled {
    /// Path in the tar.
    name: String,
    file: tokio::fs::File,
    bytes: u64,
    /// Bytes that are not read yet.
    left: u64,
}

/// The next part of the tar.
enum TarState {
    Header(Spooled),
    Content(Spooled),
    File,
    Trailer,
    End,
}

/// The folder for files until their size is known, and the maximum size of one.
struct Spool {
    folder: PathBuf,
    limit: u64,
}

/// Receives the files of a form as a tar with the files in order: `first`, then the rest of `form`. After an error nothing of it
/// is left on disk.
pub(super) async fn receive(
    app: &AppState,
    caller: &Caller,
    first: Spooled,
    form: Multipart,
    limit: u64,
) -> Result<StagedUpload, Problem> {
    let mut fault = None;
    let body = tar(first, form, Spool::of(app)).map_err(|found| {
        let text = found.to_string();
        fault = Some(found);
        text
    });
    let name: String = app.jobs.fresh_id();
    let received = app.store.receive(&caller.tenant, &name, body, limit).await;
    received.map_err(|error| match fault {
        Some(fault) => fault.problem(caller),
        None => caller.problem_for(error),
    })
}

/// Receives the first file of a form.
pub(super) async fn first(app: &AppState, caller: &Caller, field: Field<'_>) -> Result<Spooled, Problem> {
    Spool::of(app).take(field).await.map_err(|fault| fault.problem(caller))
}

/// The files of a form as the bytes of a tar. The same files in the same order give the same bytes.
fn tar(first: Spooled, form: Multipart, spool: Spool) -> impl Stream<Item = Result<Bytes, FormError>> {
    stream::try_unfold((TarState::Header(first), form, spool), async |(next, mut form, spool)| {
        let next = match (next, &mut form) {
            (TarState::File, form) => match form.next_field().await? {
                Some(field) => TarState::Header(spool.take(field).await?),
                None => TarState::Trailer,
            },
            (next, _) => next,
        };
        let (bytes, next) = match next {
            TarState::Header(spooled) => (header(&spooled)?, TarState::Content(spooled)),
            TarState::Content(mut spooled) => {
                let bytes = spooled.chunk().await?;
                (bytes, if spooled.left > 0 { TarState::Content(spooled) } else { TarState::File })
            }
            // Two empty records end a tar.
            TarState::Trailer | TarState::File => (vec![0; 2 * RECORD], TarState::End),
            TarState::End => return Ok(None),
        };
        Ok(Some((Bytes::from(bytes), (next, form, spool))))
    })
}

impl Spool {
    fn of(app: &AppState) -> Self {
        let folder = app.store.artifacts().local_path("incoming");
        Self { folder, limit: app.import_limits.max_entry_bytes }
    }

    /// Receives a whole file.
    async fn take(&self, mut field: Field<'_>) -> Result<Spooled, FormError> {
        let name = field.name().unwrap_or_default();
        let wrong = |detail: &str| FormError::File { pointer: format!("/{name}"), detail: detail.to_owned() };
        if name != FIELD {
            return Err(wrong(&format!("is not allowed; a form of files has only the field {FIELD:?}")));
        }
        let path = field.file_name().unwrap_or_default().to_owned();
        if path.is_empty() {
            return Err(wrong("the file name is missing; it must be the path of the file in the capture"));
        }
        if path.len() > MAX_NAME_BYTES || path.contains(char::is_control) {
            return Err(wrong(
                "the file name is longer than 1024 bytes or has a control character; rename the file",
            ));
        }
        tokio::fs::create_dir_all(&self.folder).await?;
        let mut file = tokio::fs::File::from_std(tempfile::tempfile_in(&self.folder)?);
        let mut bytes = 0;
        while let Some(chunk) = field.chunk().await? {
            bytes += chunk.len() as u64;
            if bytes > self.limit {
                return Err(FormError::TooLarge { name: path, limit: self.limit });
            }
            file.write_all(&chunk).await?;
        }
        file.flush().await?;
        file.seek(SeekFrom::Start(0)).await?;
        Ok(Spooled { name: path, file, bytes, left: bytes })
    }
}

impl Spooled {
    /// The next chunk of bytes. The last record is filled with zeros.
    async fn chunk(&mut self) -> Result<Vec<u8>, FormError> {
        let take = self.left.min(CHUNK as u64) as usize;
        let mut bytes = vec![0; take];
        self.file.read_exact(&mut bytes).await?;
        self.left -= take as u64;
        if self.left == 0 {
            bytes.resize(bytes.len().next_multiple_of(RECORD), 0);
        }
        Ok(bytes)
    }
}

/// The tar header of a file, with the extension for a long name if needed.
fn header(spooled: &Spooled) -> Result<Vec<u8>, FormError> {
    let mut header = tar::Header::new_gnu();
    header.set_size(spooled.bytes);
    header.set_mode(0o644);
    header.set_mtime(0);
    let mut tar = tar::Builder::new(Vec::new());
    tar.append_data(&mut header, &spooled.name, io::empty()).map_err(|error| FormError::File {
        pointer: format!("/{FIELD}"),
        detail: format!("{:?} is not a valid path of a file in a capture: {error}", spooled.name),
    })?;
    // `into_inner` appends two empty records.
    let mut bytes = tar.into_inner()?;
    bytes.truncate(bytes.len() - 2 * RECORD);
    Ok(bytes)
}
