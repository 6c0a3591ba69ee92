//! The job source of a remote worker: the queue of a server, over its API.

use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use tokio::sync::watch;

use crate::jobs::Clock;
use crate::remote_worker::errors::source_error;
use crate::remote_worker::file_cache::FileCache;
use crate::remote_worker::observer::{Observer, WorkerEvent};
use crate::remote_worker::remote_claim::RemoteClaim;
use crate::worker::{ClaimOutcome, JobSource, JobSourceError};
use relume_api::WorkerId;
use relume_api::work::WorkerHello;
use relume_client::Client;

/// The jobs of a server, for one worker.
pub struct RemoteJobs {
    client: Client,
    hello: WorkerHello,
    cache: FileCache,
    clock: Arc<dyn Clock>,
    observer: Observer,
    changes: Arc<watch::Sender<()>>,
}

impl RemoteJobs {
    /// The jobs of the server that `client` reaches.
    pub fn new(
        client: Client,
        hello: WorkerHello,
        cache: FileCache,
        clock: Arc<dyn Clock>,
        observer: Observer,
    ) -> Self {
        Self { client, hello, cache, clock, observer, changes: Arc::new(watch::Sender::new(())) }
    }
}

#[async_trait(?Send)]
impl JobSource for RemoteJobs {
    async fn claim(&self) -> Result<ClaimOutcome, JobSourceError> {
        let claimed = self.client.claim_job(&self.hello).await.map_err(|error| {
            match error.problem().map(|problem| problem.status) {
                Some(401 | 403 | 404 | 422) => JobSourceError::Refused(error.to_string()),
                _ => source_error(error),
            }
        })?;
        match (claimed.task, claimed.lease) {
            (Some(task), Some(lease)) => {
                (self.observer)(WorkerEvent::Claimed(&task));
                let work = self.client.leased_job(task.job.clone(), lease);
                let observer = self.observer.clone();
                let beats = (self.changes.clone(), Duration::from_millis(claimed.beat_ms));
                let claim = RemoteClaim::new(work, task, self.cache.clone(), observer, beats);
                Ok(ClaimOutcome::Job(Box::new(claim)))
            }
            _ if claimed.draining => Ok(ClaimOutcome::Draining),
            _ => Ok(ClaimOutcome::Nothing),
        }
    }

    fn worker(&self) -> Option<&WorkerId> {
        Some(&self.hello.id)
    }

    fn changes(&self) -> watch::Receiver<()> {
        self.changes.subscribe()
    }

    fn now_ms(&self) -> i64 {
        self.clock.now_ms()
    }
}
