//! A typed client of the service.
//!
//! ```no_run
//! # async fn example() -> Result<(), relume::client::ClientError> {
//! use relume::api::jobs::NewJob;
//! use relume::client::Client;
//!
//! let client = Client::new("http://127.0.0.1:7878", None)?;
//! let capture = client.upload_capture("scan.zip".as_ref()).await?;
//! let job = client.create_job(&NewJob { capture: capture.id, ..NewJob::default() }, None).await?;
//! let done = client.wait(&job.id, |event| println!("{}", event.kind)).await?;
//! println!("model {:?}", done.model);
//! # Ok(()) }
//! ```

mod events;

use std::path::Path;
use std::time::Duration;

use futures::{Stream, TryStreamExt};
use reqwest::header::{ACCEPT, CONTENT_LENGTH, CONTENT_TYPE};
use reqwest::{Method, RequestBuilder, Response, Url};
use serde::de::DeserializeOwned;
use tokio::io::AsyncWriteExt;
use tokio_util::bytes::Bytes;

pub use events::JobEvent;

use crate::api::Problem;
use crate::api::captures::{CaptureReport, CaptureView};
use crate::api::environments::{EnvironmentList, EnvironmentView};
use crate::api::jobs::{JobChange, JobView, NewJob};
use crate::api::listing::List;
use crate::api::models::{ModelSummary, ModelView};
use crate::api::picture::Format;
use crate::api::renders::RenderRequest;

/// Tries to reach a server that went away while a job was waited for, one second apart.
const PATIENCE: u32 = 60;

/// Why a call failed.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The server refused; the problem says why.
    #[error("{}: {} ({})", .0.title, .0.detail.as_deref().unwrap_or_default(), .0.status)]
    Problem(Box<Problem>),
    /// The server could not be reached or broke off.
    #[error("transport: {0}")]
    Transport(#[from] reqwest::Error),
    /// The answer was not what the API promises.
    #[error("unexpected answer: {0}")]
    Unexpected(String),
    /// The server's address is no URL.
    #[error("address: {0}")]
    Address(String),
    /// A local file failed.
    #[error("file: {0}")]
    File(#[from] std::io::Error),
}

impl ClientError {
    /// The problem, when the server refused.
    pub fn problem(&self) -> Option<&Problem> {
        match self {
            Self::Problem(problem) => Some(problem),
            _ => None,
        }
    }
}

type Result<T> = std::result::Result<T, ClientError>;

/// A connection to one server. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Client {
    http: reqwest::Client,
    base: Url,
    key: Option<String>,
}

impl Client {
    /// A client of the server at `base`, e.g. `http://127.0.0.1:7878`.
    ///
    /// # Errors
    /// When `base` is no URL.
    pub fn new(base: &str, key: Option<String>) -> Result<Self> {
        let base = Url::parse(base).map_err(|e| ClientError::Address(e.to_string()))?;
        let http = reqwest::Client::builder().connect_timeout(Duration::from_secs(10)).build()?;
        Ok(Self { http, base, key })
    }

    /// The server's address.
    pub fn base(&self) -> &Url {
        &self.base
    }

    /// A request to `path`, with the key; for what has no method here.
    ///
    /// # Errors
    /// When `path` does not make a URL.
    pub fn request(&self, method: Method, path: &str) -> Result<RequestBuilder> {
        let url = self.base.join(path).map_err(|e| ClientError::Address(e.to_string()))?;
        let request = self.http.request(method, url);
        Ok(match &self.key {
            Some(key) => request.bearer_auth(key),
            None => request,
        })
    }

    /// Uploads a zip, tar or tar.gz, streaming it from disk.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn upload_capture(&self, archive: &Path) -> Result<CaptureView> {
        let file = tokio::fs::File::open(archive).await?;
        let length = file.metadata().await?.len();
        let body = reqwest::Body::wrap_stream(tokio_util::io::ReaderStream::new(file));
        self.post_archive("/v1/captures", body, Some(length)).await
    }

    /// Uploads an archive from memory.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn upload_capture_bytes(&self, archive: impl Into<Bytes>) -> Result<CaptureView> {
        self.post_archive("/v1/captures", archive.into().into(), None).await
    }

    /// Asks what an upload would say, without keeping anything.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn validate_capture_bytes(&self, archive: impl Into<Bytes>) -> Result<CaptureReport> {
        self.post_archive("/v1/captures/validate", archive.into().into(), None).await
    }

    async fn post_archive<T: DeserializeOwned>(
        &self,
        path: &str,
        body: reqwest::Body,
        length: Option<u64>,
    ) -> Result<T> {
        let request = self.request(Method::POST, path)?.header(CONTENT_TYPE, "application/octet-stream");
        let request = match length {
            Some(length) => request.header(CONTENT_LENGTH, length),
            None => request,
        };
        json(request.body(body)).await
    }

    /// A capture.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn capture(&self, id: &str) -> Result<CaptureView> {
        json(self.request(Method::GET, &format!("/v1/captures/{id}"))?).await
    }

    /// The newest captures.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn captures(&self) -> Result<List<CaptureView>> {
        json(self.request(Method::GET, "/v1/captures")?).await
    }

    /// Uploads an HDR environment map.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn upload_environment(&self, file: impl Into<Bytes>) -> Result<EnvironmentView> {
        let request = self.request(Method::POST, "/v1/environments")?;
        json(request.header(CONTENT_TYPE, "application/octet-stream").body(file.into())).await
    }

    /// Built-in and uploaded environment maps.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn environments(&self) -> Result<EnvironmentList> {
        json(self.request(Method::GET, "/v1/environments")?).await
    }

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
    pub async fn job(&self, id: &str) -> Result<JobView> {
        json(self.request(Method::GET, &format!("/v1/jobs/{id}"))?).await
    }

    /// The newest jobs.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn jobs(&self) -> Result<List<JobView>> {
        json(self.request(Method::GET, "/v1/jobs")?).await
    }

    /// Cancels a job.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn cancel_job(&self, id: &str) -> Result<JobView> {
        json(self.request(Method::POST, &format!("/v1/jobs/{id}/cancel"))?).await
    }

    /// Runs a failed or cancelled job again, as a new one.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn retry_job(&self, id: &str) -> Result<JobView> {
        json(self.request(Method::POST, &format!("/v1/jobs/{id}/retry"))?).await
    }

    /// Changes the priority of a waiting job.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn set_priority(&self, id: &str, priority: i64) -> Result<JobView> {
        let request = self.request(Method::PATCH, &format!("/v1/jobs/{id}"))?;
        json(request.json(&JobChange { priority })).await
    }

    /// A job's events above number `after`, then those that happen, until the job or the connection ends.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn events(
        &self,
        job: &str,
        after: i64,
    ) -> Result<impl Stream<Item = Result<JobEvent>> + use<>> {
        let request = self.request(Method::GET, &format!("/v1/jobs/{job}/events"))?;
        let response = checked(request.header("last-event-id", after)).await?;
        Ok(events::parse(response.bytes_stream().map_err(ClientError::from)))
    }

    /// Follows a job to its end, also across restarts of the server; every event is told once.
    ///
    /// # Errors
    /// The server's refusal, or that it stayed away for a minute.
    pub async fn wait(&self, job: &str, mut on_event: impl FnMut(&JobEvent)) -> Result<JobView> {
        let (mut last, mut failures) = (0, 0);
        loop {
            let outcome = self.follow(job, &mut last, &mut on_event).await;
            match outcome {
                Ok(Some(view)) => return Ok(view),
                Ok(None) => failures = 0,
                Err(ClientError::Transport(error)) if failures < PATIENCE => {
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
        job: &str,
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

    /// A model, its files and its card.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn model(&self, id: &str) -> Result<ModelView> {
        json(self.request(Method::GET, &format!("/v1/models/{id}"))?).await
    }

    /// The newest models.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn models(&self) -> Result<List<ModelSummary>> {
        json(self.request(Method::GET, "/v1/models")?).await
    }

    /// A file of a model, in memory.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn file(&self, model: &str, name: &str) -> Result<Bytes> {
        let request = self.request(Method::GET, &format!("/v1/models/{model}/files/{name}"))?;
        Ok(checked(request).await?.bytes().await?)
    }

    /// Downloads a file of a model to `path`.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way; an incomplete file may then be at `path`.
    pub async fn download(&self, model: &str, name: &str, path: &Path) -> Result<()> {
        let request = self.request(Method::GET, &format!("/v1/models/{model}/files/{name}"))?;
        let mut body = checked(request).await?.bytes_stream();
        let mut file = tokio::fs::File::create(path).await?;
        while let Some(chunk) = body.try_next().await? {
            file.write_all(&chunk).await?;
        }
        Ok(file.sync_all().await?)
    }

    /// A rendered frame as an image file.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn render(&self, model: &str, request: &RenderRequest, format: Format) -> Result<Bytes> {
        let post = self.request(Method::POST, &format!("/v1/models/{model}/render"))?;
        let response = checked(post.header(ACCEPT, format.media_type()).json(request)).await?;
        Ok(response.bytes().await?)
    }

    /// A thumbnail; `query` as in the API, e.g. `env=studio&size=128`.
    ///
    /// # Errors
    /// The server's refusal, or what failed on the way.
    pub async fn thumbnail(&self, model: &str, query: &str) -> Result<Bytes> {
        let request = self.request(Method::GET, &format!("/v1/models/{model}/thumbnail?{query}"))?;
        Ok(checked(request).await?.bytes().await?)
    }
}

/// Sends; a refusal becomes an error.
async fn checked(request: RequestBuilder) -> Result<Response> {
    let response = request.send().await?;
    if response.status().is_success() {
        return Ok(response);
    }
    let status = response.status();
    let body = response.bytes().await?;
    Err(match serde_json::from_slice(&body) {
        Ok(problem) => ClientError::Problem(Box::new(problem)),
        Err(_) => ClientError::Unexpected(format!("status {status} without a problem")),
    })
}

async fn json<T: DeserializeOwned>(request: RequestBuilder) -> Result<T> {
    let body = checked(request).await?.bytes().await?;
    serde_json::from_slice(&body).map_err(|e| ClientError::Unexpected(e.to_string()))
}
