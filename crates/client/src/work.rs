//! What a worker asks of a server and tells it. The key needs the scope `work`.

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

/// The header with the lease's token.
const LEASE: &str = "relume-lease";
/// How long the answer to a small message may take.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(30);
/// How long the server may take to publish a model: it reads the files once more.
const PUBLISH_TIMEOUT: Duration = Duration::from_secs(300);
/// How long a file may take on its way to the server.
const UPLOAD_TIMEOUT: Duration = Duration::from_secs(3600);

impl Client {
    /// Asks for a job, which also says that the worker is there.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn claim_job(&self, hello: &WorkerHello) -> Result<Claimed> {
        json(self.request(Method::POST, "/v1/work/claims")?.timeout(RESPONSE_TIMEOUT).json(hello)).await
    }

    /// All workers.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn workers(&self) -> Result<List<WorkerView>> {
        json(self.request(Method::GET, "/v1/workers")?).await
    }

    /// Says whether a worker is given jobs.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn change_worker(&self, id: &WorkerId, change: &WorkerChange) -> Result<WorkerView> {
        json(self.request(Method::PATCH, &format!("/v1/workers/{id}"))?.json(change)).await
    }

    /// The job that a lease is on.
    pub fn leased_job(&self, job: JobId, lease: String) -> LeasedJob {
        LeasedJob { client: self.clone(), job, lease }
    }
}

/// A job that a worker holds the lease of. Every call is refused with 409 once the lease is lost.
#[derive(Debug, Clone)]
pub struct LeasedJob {
    client: Client,
    job: JobId,
    lease: String,
}

impl LeasedJob {
    /// Says that the worker is there.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn heartbeat(&self) -> Result<LeaseView> {
        json(self.request(Method::POST, "heartbeat")?.timeout(RESPONSE_TIMEOUT)).await
    }

    /// Reports progress, which renews the lease.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn progress(&self, progress: &JobProgress) -> Result<LeaseView> {
        self.post("progress", progress).await
    }

    /// Warns the user.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn warn(&self, message: &str) -> Result<LeaseView> {
        self.post("warnings", &WorkWarning { message: message.to_owned() }).await
    }

    /// Publishes a model whose files were sent.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn publish(&self, model: &FinishedModel) -> Result<LeaseView> {
        json(self.request(Method::POST, "model")?.timeout(PUBLISH_TIMEOUT).json(model)).await
    }

    /// Ends the attempt without a model.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn end(&self, end: &WorkEnd) -> Result<LeaseView> {
        self.post("end", end).await
    }

    /// Sends a checkpoint.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn put_checkpoint(&self, step: i64, bytes: Bytes) -> Result<LeaseView> {
        json(self.request(Method::PUT, &format!("checkpoints/{step}"))?.timeout(UPLOAD_TIMEOUT).body(bytes))
            .await
    }

    /// Sends a file of the model.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn put_file(&self, name: &str, bytes: Bytes) -> Result<SentFile> {
        json(self.request(Method::PUT, &format!("files/{name}"))?.timeout(UPLOAD_TIMEOUT).body(bytes)).await
    }

    /// The capture.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn capture(&self) -> Result<Download> {
        self.fetch("capture").await
    }

    /// An environment map of the job's tenant.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn environment(&self, id: &EnvironmentId) -> Result<Download> {
        self.fetch(&format!("environments/{id}")).await
    }

    /// The checkpoint to go on from.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
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
