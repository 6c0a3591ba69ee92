//! The jobs of a server, over its API.

use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use tokio::sync::watch;

use crate::api::WorkerId;
use crate::api::work::WorkerHello;
use crate::client::Client;
use crate::farm::errors::source_error;
use crate::farm::file_cache::FileCache;
use crate::farm::observer::{Observer, Told};
use crate::farm::remote_claim::RemoteClaim;
use crate::jobs::Clock;
use crate::worker::{Claimed, Source, SourceError};

/// The jobs of a server for one worker.
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
impl Source for RemoteJobs {
    async fn claim(&self) -> Result<Claimed, SourceError> {
        let claimed = self.client.claim_job(&self.hello).await.map_err(|error| {
            match error.problem().map(|problem| problem.status) {
                Some(401 | 403 | 404 | 422) => SourceError::Refused(error.to_string()),
                _ => source_error(error),
            }
        })?;
        match (claimed.task, claimed.lease) {
            (Some(task), Some(lease)) => {
                (self.observer)(Told::Claimed(&task));
                let work = self.client.work(task.job.clone(), lease);
                let observer = self.observer.clone();
                let beats = (self.changes.clone(), Duration::from_millis(claimed.beat_ms));
                let claim = RemoteClaim::new(work, task, self.cache.clone(), observer, beats);
                Ok(Claimed::Job(Box::new(claim)))
            }
            _ if claimed.draining => Ok(Claimed::Draining),
            _ => Ok(Claimed::Nothing),
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
