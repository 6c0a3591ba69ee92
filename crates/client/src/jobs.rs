//! Jobs and their events.

use std::time::Duration;

use futures::{Stream, TryStreamExt};
use reqwest::Method;
use tokio_util::bytes::Bytes;

use crate::connection::{Client, checked, json};
use crate::error::{ClientError, Result};
use crate::events::{self, JobEvent};
use relume_api::jobs::{JobChange, JobView, NewJob};
use relume_api::{JobId, List};

/// Most tries to reach a server that went away while a job is waited for, one second apart.
const MAX_CONNECT_ATTEMPTS: u32 = 60;

impl Client {
    /// Queues a training; the same key with the same job queues one.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn create_job(&self, job: &NewJob, idempotency_key: Option<&str>) -> Result<JobView> {
        let request = self.request(Method::POST, "/v1/jobs")?.json(job);
        json(match idempotency_key {
            Some(key) => request.header("idempotency-key", key),
            None => request,
        })
        .await
    }

    /// A job.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn job(&self, id: &JobId) -> Result<JobView> {
        json(self.request(Method::GET, &format!("/v1/jobs/{id}"))?).await
    }

    /// The newest jobs.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn jobs(&self) -> Result<List<JobView>> {
        json(self.request(Method::GET, "/v1/jobs")?).await
    }

    /// How a training looks now, a PNG of `size` pixels a side, 16 to 1024; of a job with a model, that model's thumbnail.
    ///
    /// # Errors
    /// The server's refusal, e.g. as long as there is no picture, or what failed on the way.
    pub async fn job_preview(&self, id: &JobId, size: u32) -> Result<Bytes> {
        let request = self.request(Method::GET, &format!("/v1/jobs/{id}/preview?size={size}"))?;
        Ok(checked(request).await?.bytes().await?)
    }

    /// Cancels a job.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn cancel_job(&self, id: &JobId) -> Result<JobView> {
        json(self.request(Method::POST, &format!("/v1/jobs/{id}/cancel"))?).await
    }

    /// Runs a failed or cancelled job again, as a new one.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn retry_job(&self, id: &JobId) -> Result<JobView> {
        json(self.request(Method::POST, &format!("/v1/jobs/{id}/retry"))?).await
    }

    /// Changes the priority of a waiting job.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn set_priority(&self, id: &JobId, priority: i64) -> Result<JobView> {
        let request = self.request(Method::PATCH, &format!("/v1/jobs/{id}"))?;
        json(request.json(&JobChange { priority: Some(priority), ..JobChange::default() })).await
    }

    /// Changes what a job is called, or its priority.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn change_job(&self, id: &JobId, change: &JobChange) -> Result<JobView> {
        json(self.request(Method::PATCH, &format!("/v1/jobs/{id}"))?.json(change)).await
    }

    /// A job's events above number `after`, then those that happen, until the job or the connection ends.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn events(
        &self,
        job: &JobId,
        after: i64,
    ) -> Result<impl Stream<Item = Result<JobEvent>> + use<>> {
        let request = self.request(Method::GET, &format!("/v1/jobs/{job}/events"))?;
        let response = checked(request.header("last-event-id", after)).await?;
        Ok(events::parse(response.bytes_stream()))
    }

    /// Follows a job to its end, also across restarts of the server; every event is passed on once.
    ///
    /// # Errors
    /// The server's refusal, or that it could not be reached for a minute.
    pub async fn wait(&self, job: &JobId, mut on_event: impl FnMut(&JobEvent)) -> Result<JobView> {
        let (mut last, mut failures) = (0, 0);
        loop {
            let outcome = self.follow(job, &mut last, &mut on_event).await;
            match outcome {
                Ok(Some(view)) => return Ok(view),
                Ok(None) => failures = 0,
                Err(ClientError::Transport(error)) if failures < MAX_CONNECT_ATTEMPTS => {
                    tracing::debug!(%error, "the server is away");
                    failures += 1;
                }
                Err(error) => return Err(error),
            }
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    }

    /// One connection's worth of events; the job when it has ended.
    async fn follow(
        &self,
        job: &JobId,
        last: &mut i64,
        on_event: &mut impl FnMut(&JobEvent),
    ) -> Result<Option<JobView>> {
        let mut events = std::pin::pin!(self.events(job, *last).await?);
        while let Some(event) = events.try_next().await? {
            *last = event.seq;
            on_event(&event);
        }
        let view = self.job(job).await?;
        Ok(Some(view).filter(|v| v.state.is_terminal()))
    }
}
