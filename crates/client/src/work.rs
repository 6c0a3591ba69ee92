//! Requests of a worker to the server. The key needs the scope `work`.

use std::time::Duration;

use reqwest::{Method, RequestBuilder};
use serde::Serialize;
use tokio_util::bytes::Bytes;

use crate::connection::{Client, json};
use crate::download::Download;
use crate::error::Result;
use relume_api::jobs::JobProgress;
use relume_api::work::{
    Claimed, FinishedModel, LeaseView, SentFile, WorkEnd, WorkWarning, WorkerChange, WorkerHello, WorkerView,
};
use relume_api::{EnvironmentId, JobId, List, WorkerId};

/// Header with the token of the lease.
const LEASE: &str = "relume-lease";
/// Timeout of the response to a small message.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(30);
/// Timeout of publishing a model, during which the server reads the files once more.
const PUBLISH_TIMEOUT: Duration = Duration::from_secs(300);
/// Timeout of sending a file to the server.
const UPLOAD_TIMEOUT: Duration = Duration::from_secs(3600);

impl Client {
    /// Requests a job; also counts as a heartbeat of the worker.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn claim_job(&self, hello: &WorkerHello) -> Result<Claimed> {
        json(self.request(Method::POST, "/v1/work/claims")?.timeout(RESPONSE_TIMEOUT).json(hello)).await
    }

    /// All workers.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn workers(&self) -> Result<List<WorkerView>> {
        json(self.request(Method::GET, "/v1/workers")?).await
    }

    /// Sets whether a worker is given jobs.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn change_worker(&self, id: &WorkerId, change: &WorkerChange) -> Result<WorkerView> {
        json(self.request(Method::PATCH, &format!("/v1/workers/{id}"))?.json(change)).await
    }

    /// The job of a lease.
    pub fn leased_job(&self, job: JobId, lease: String) -> LeasedJob {
        LeasedJob { client: self.clone(), job, lease }
    }
}

/// A job whose lease a worker holds. Every call is refused with 409 once the lease is lost.
#[derive(Debug, Clone)]
pub struct LeasedJob {
    client: Client,
    job: JobId,
    lease: String,
}

impl LeasedJob {
    /// Sends a heartbeat.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn heartbeat(&self) -> Result<LeaseView> {
        json(self.request(Method::POST, "heartbeat")?.timeout(RESPONSE_TIMEOUT)).await
    }

    /// Reports progress, which renews the lease.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn progress(&self, progress: &JobProgress) -> Result<LeaseView> {
        self.post("progress", progress).await
    }

    /// Sends a warning for the user.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn warn(&self, message: &str) -> Result<LeaseView> {
        self.post("warnings", &WorkWarning { message: message.to_owned() }).await
    }

    /// Publishes a model whose files have been sent.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn publish(&self, model: &FinishedModel) -> Result<LeaseView> {
        json(self.request(Method::POST, "model")?.timeout(PUBLISH_TIMEOUT).json(model)).await
    }

    /// Ends the attempt without a model.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn end(&self, end: &WorkEnd) -> Result<LeaseView> {
        self.post("end", end).await
    }

    /// Sends a checkpoint.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn put_checkpoint(&self, step: i64, bytes: Bytes) -> Result<LeaseView> {
        json(self.request(Method::PUT, &format!("checkpoints/{step}"))?.timeout(UPLOAD_TIMEOUT).body(bytes))
            .await
    }

    /// Sends a file of the model.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn put_file(&self, name: &str, bytes: Bytes) -> Result<SentFile> {
        json(self.request(Method::PUT, &format!("files/{name}"))?.timeout(UPLOAD_TIMEOUT).body(bytes)).await
    }

    /// Downloads the capture.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn capture(&self) -> Result<Download> {
        self.fetch("capture").await
    }

    /// Downloads an environment map of the job's tenant.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn environment(&self, id: &EnvironmentId) -> Result<Download> {
        self.fetch(&format!("environments/{id}")).await
    }

    /// Downloads the checkpoint from which to resume.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn checkpoint(&self) -> Result<Download> {
        self.fetch("checkpoint").await
    }

    async fn post(&self, what: &str, body: &(impl Serialize + Sync)) -> Result<LeaseView> {
        json(self.request(Method::POST, what)?.timeout(RESPONSE_TIMEOUT).json(body)).await
    }

    async fn fetch(&self, what: &str) -> Result<Download> {
        Download::begin(self.request(Method::GET, what)?).await
    }

    fn request(&self, method: Method, what: &str) -> Result<RequestBuilder> {
        let request = self.client.request(method, &format!("/v1/work/{}/{what}", self.job))?;
        Ok(request.header(LEASE, &self.lease))
    }
}
