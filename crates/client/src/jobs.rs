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

/// Greatest number of attempts to reconnect while waiting for a job, one second apart.
const MAX_CONNECT_ATTEMPTS: u32 = 60;

impl Client {
    /// Queues a training. Repeating the request with the same idempotency key queues it only once.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
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
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn job(&self, id: &JobId) -> Result<JobView> {
        json(self.request(Method::GET, &format!("/v1/jobs/{id}"))?).await
    }

    /// The newest jobs.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn jobs(&self) -> Result<List<JobView>> {
        json(self.request(Method::GET, "/v1/jobs")?).await
    }

    /// The current preview of a training: a PNG of `size` pixels per side, 16 to 1024. For a job with a model, the
    /// model's thumbnail.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, e.g. because there is no preview yet, or it failed.
    pub async fn job_preview(&self, id: &JobId, size: u32) -> Result<Bytes> {
        let request = self.request(Method::GET, &format!("/v1/jobs/{id}/preview?size={size}"))?;
        Ok(checked(request).await?.bytes().await?)
    }

    /// Cancels a job.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn cancel_job(&self, id: &JobId) -> Result<JobView> {
        json(self.request(Method::POST, &format!("/v1/jobs/{id}/cancel"))?).await
    }

    /// Runs a failed or cancelled job again, as a new job.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn retry_job(&self, id: &JobId) -> Result<JobView> {
        json(self.request(Method::POST, &format!("/v1/jobs/{id}/retry"))?).await
    }

    /// Changes the priority of a queued job.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn set_priority(&self, id: &JobId, priority: i64) -> Result<JobView> {
        let request = self.request(Method::PATCH, &format!("/v1/jobs/{id}"))?;
        json(request.json(&JobChange { priority: Some(priority), ..JobChange::default() })).await
    }

    /// Changes the metadata or the priority of a job.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn change_job(&self, id: &JobId, change: &JobChange) -> Result<JobView> {
        json(self.request(Method::PATCH, &format!("/v1/jobs/{id}"))?.json(change)).await
    }

    /// A job's events with numbers above `after`, then new ones, until the job or the connection ends.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn events(
        &self,
        job: &JobId,
        after: i64,
    ) -> Result<impl Stream<Item = Result<JobEvent>> + use<>> {
        let request = self.request(Method::GET, &format!("/v1/jobs/{job}/events"))?;
        let response = checked(request.header("last-event-id", after)).await?;
        Ok(events::parse(response.bytes_stream()))
    }

    /// Follows a job to its end, also across restarts of the server. Every event is passed on exactly once.
    ///
    /// # Errors
    /// [`ClientError`]: the server refused a request, or was unreachable for a minute.
    pub async fn wait(&self, job: &JobId, mut on_event: impl FnMut(&JobEvent)) -> Result<JobView> {
        let (mut last, mut failures) = (0, 0);
        loop {
            let outcome = self.follow(job, &mut last, &mut on_event).await;
            match outcome {
                Ok(Some(view)) => return Ok(view),
                Ok(None) => failures = 0,
                Err(ClientError::Transport(error)) if failures < MAX_CONNECT_ATTEMPTS => {
                    tracing::debug!(%error, "the server is unreachable");
                    failures += 1;
                }
                Err(error) => return Err(error),
            }
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    }

    /// Follows the events of one connection. Returns the job if it has ended.
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
