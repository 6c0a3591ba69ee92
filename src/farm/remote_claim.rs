//! A job of a server, over its API. While it is held the server hears of the worker every few seconds.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use sha2::{Digest, Sha256};
use tokio::sync::watch;
use tokio_util::bytes::Bytes;

use crate::api::EnvironmentId;
use crate::api::jobs::JobProgress;
use crate::api::work::{FinishedModel, LeaseStatus, LeaseView, Release, Task, WorkEnd};
use crate::client::work::Work;
use crate::client::{ClientError, Download};
use crate::farm::errors::source_error;
use crate::farm::file_cache::{CacheError, FileCache};
use crate::farm::observer::{Observer, Told};
use crate::store::hex;
use crate::worker::{Claim, SourceError, TrainedModel};

/// Least time between two signs of life.
const LEAST_BEAT: Duration = Duration::from_millis(100);
/// How often something is tried again while the server cannot be reached, and how long to wait in between.
const PATIENCE: u32 = 60;
const AGAIN: Duration = Duration::from_secs(1);

/// The lease on a job of a server.
pub(super) struct RemoteClaim {
    work: Work,
    task: Task,
    cache: FileCache,
    observer: Observer,
    beating: tokio::task::JoinHandle<()>,
}

impl Drop for RemoteClaim {
    fn drop(&mut self) {
        self.beating.abort();
    }
}

impl RemoteClaim {
    /// Must be called inside a tokio runtime. `changes` wakes when the job is to stop, which is asked for every so often.
    pub(super) fn new(
        work: Work,
        task: Task,
        cache: FileCache,
        observer: Observer,
        (changes, every): (Arc<watch::Sender<()>>, Duration),
    ) -> Self {
        let beating = tokio::spawn(beat(work.clone(), changes, every.max(LEAST_BEAT)));
        Self { work, task, cache, observer, beating }
    }

    async fn end(&self, end: WorkEnd) -> Result<LeaseStatus, SourceError> {
        standing(patiently(async || self.work.end(&end).await).await)
    }

    async fn kept(&self, found: Result<Download, ClientError>) -> Result<(PathBuf, String), CacheError> {
        self.cache.keep(found?).await
    }
}

/// Says that the worker is there until the lease is lost.
async fn beat(work: Work, changes: Arc<watch::Sender<()>>, every: Duration) {
    loop {
        tokio::time::sleep(every).await;
        match standing(work.beat().await) {
            Ok(LeaseStatus::Held) => {}
            Ok(LeaseStatus::Cancelling | LeaseStatus::Lost) => {
                changes.send_replace(());
            }
            Err(error) => tracing::warn!(%error, "the server did not hear of this worker"),
        }
    }
}

#[async_trait(?Send)]
impl Claim for RemoteClaim {
    fn task(&self) -> &Task {
        &self.task
    }

    async fn capture(&self) -> Result<PathBuf, SourceError> {
        let fetched = patiently_kept(async || self.kept(self.work.capture().await).await).await;
        fetched.map(|(path, _)| path)
    }

    async fn environment(&self, id: &EnvironmentId) -> Result<(PathBuf, String), SourceError> {
        patiently_kept(async || self.kept(self.work.environment(id).await).await).await
    }

    async fn last_checkpoint(&self) -> Result<Bytes, SourceError> {
        let fetched = patiently(async || {
            let download = self.work.checkpoint().await?;
            let sha256 = download.sha256();
            Ok((download.whole().await?, sha256))
        });
        let (bytes, sha256) = fetched.await.map_err(source_error)?;
        // Those from before hashes were kept have none.
        let is_sound = sha256.is_empty() || hex(&Sha256::digest(&bytes)) == sha256;
        if is_sound { Ok(bytes) } else { Err(SourceError::Damaged) }
    }

    async fn check(&self) -> Result<LeaseStatus, SourceError> {
        standing(self.work.beat().await)
    }

    async fn progress(&self, progress: &JobProgress) -> Result<LeaseStatus, SourceError> {
        (self.observer)(Told::Progress(progress));
        standing(patiently(async || self.work.progress(progress).await).await)
    }

    async fn warn(&self, message: &str) -> Result<LeaseStatus, SourceError> {
        (self.observer)(Told::Warning(message));
        standing(patiently(async || self.work.warn(message).await).await)
    }

    async fn checkpoint(&self, step: i64, bytes: Vec<u8>) -> Result<LeaseStatus, SourceError> {
        let bytes = Bytes::from(bytes);
        standing(patiently(async || self.work.put_checkpoint(step, bytes.clone()).await).await)
    }

    async fn publish(&self, model: TrainedModel) -> Result<LeaseStatus, SourceError> {
        let TrainedModel { gaussians, card, figures, files } = model;
        let mut sent = Vec::with_capacity(files.len());
        for (name, bytes) in files {
            let bytes = Bytes::from(bytes);
            match patiently(async || self.work.put_file(name, bytes.clone()).await).await {
                Ok(file) => sent.push(file),
                Err(error) => return lost_or(error),
            }
        }
        let model = FinishedModel { gaussians, card, figures, files: sent };
        let status = standing(patiently(async || self.work.publish(&model).await).await)?;
        if status == LeaseStatus::Held {
            (self.observer)(Told::Published);
        }
        Ok(status)
    }

    async fn fail(&self, code: &str, detail: &str) -> Result<LeaseStatus, SourceError> {
        (self.observer)(Told::Failed(detail));
        self.end(WorkEnd::Failed { code: code.to_owned(), detail: detail.to_owned() }).await
    }

    async fn confirm_cancel(&self) -> Result<LeaseStatus, SourceError> {
        (self.observer)(Told::Cancelled);
        self.end(WorkEnd::Cancelled).await
    }

    async fn release(&self, release: Release) -> Result<LeaseStatus, SourceError> {
        (self.observer)(Told::Released);
        self.end(WorkEnd::Released { why: release }).await
    }
}

/// How the lease stands by an answer.
fn standing(answer: Result<LeaseView, ClientError>) -> Result<LeaseStatus, SourceError> {
    match answer {
        Ok(view) => Ok(view.status),
        Err(error) => lost_or(error),
    }
}

fn lost_or(error: ClientError) -> Result<LeaseStatus, SourceError> {
    let is_lost = error.problem().is_some_and(|problem| problem.kind.ends_with("lease-lost"));
    if is_lost { Ok(LeaseStatus::Lost) } else { Err(source_error(error)) }
}

/// Whether it may go better a second later.
fn may_pass(error: &ClientError) -> bool {
    match error {
        ClientError::Transport(_) => true,
        error => error.problem().is_some_and(|problem| matches!(problem.status, 408 | 429 | 502..=504)),
    }
}

/// Does what can be done twice, and again while the server cannot be reached, for [`PATIENCE`] tries.
async fn patiently<T>(act: impl AsyncFn() -> Result<T, ClientError>) -> Result<T, ClientError> {
    for _ in 0..PATIENCE {
        match act().await {
            Err(error) if may_pass(&error) => tokio::time::sleep(AGAIN).await,
            done => return done,
        }
    }
    act().await
}

/// As [`patiently`], of a file; bytes that changed on the way are fetched once more.
async fn patiently_kept<T>(act: impl AsyncFn() -> Result<T, CacheError>) -> Result<T, SourceError> {
    let mut wrong = 0;
    for _ in 0..PATIENCE {
        match act().await {
            Err(CacheError::Client(error)) if may_pass(&error) => tokio::time::sleep(AGAIN).await,
            Err(CacheError::Io(error)) if error.kind() == io::ErrorKind::TimedOut => {
                tokio::time::sleep(AGAIN).await;
            }
            Err(CacheError::WrongBytes) if wrong == 0 => wrong += 1,
            Ok(done) => return Ok(done),
            Err(CacheError::Client(error)) => return Err(source_error(error)),
            Err(CacheError::WrongBytes) => return Err(SourceError::Damaged),
            Err(CacheError::Io(error)) if error.kind() == io::ErrorKind::StorageFull => {
                return Err(SourceError::Full);
            }
            Err(error @ CacheError::Io(_)) => return Err(SourceError::Failed(error.to_string())),
        }
    }
    Err(SourceError::Unreachable("the server cannot be reached".to_owned()))
}
