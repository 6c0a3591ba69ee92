//! Requests to one server and its responses.

use std::time::Duration;

use reqwest::redirect::{Action, Attempt, Policy};
use reqwest::{Method, RequestBuilder, Response, StatusCode, Url};
use serde::de::DeserializeOwned;

use crate::error::{ClientError, Result};

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
    /// If `base` is not a URL, or not one of HTTP.
    pub fn new(base: &str, key: Option<String>) -> Result<Self> {
        let wrong = |why: &str| ClientError::Address(format!("{base:?}: {why}"));
        let base = Url::parse(base).map_err(|e| wrong(&e.to_string()))?;
        if !matches!(base.scheme(), "http" | "https") {
            return Err(wrong("must begin with http:// or https://"));
        }
        // TLS provider for `https://`. A provider that the process has already installed is also suitable.
        tokio_rustls::rustls::crypto::ring::default_provider().install_default().ok();
        let http = reqwest::Client::builder().redirect(Policy::custom(follow));
        let http = http.connect_timeout(Duration::from_secs(10)).build()?;
        Ok(Self { http, base, key })
    }

    /// The server's address.
    pub fn base(&self) -> &Url {
        &self.base
    }

    /// A request to `path` with the API key, for endpoints without a method here.
    ///
    /// # Errors
    /// If `path` does not give a valid URL.
    pub fn request(&self, method: Method, path: &str) -> Result<RequestBuilder> {
        let url = self.base.join(path).map_err(|e| ClientError::Address(e.to_string()))?;
        let request = self.http.request(method, url);
        Ok(match &self.key {
            Some(key) => request.bearer_auth(key),
            None => request,
        })
    }
}

/// Redirects of the API are followed with the key. A redirect to a file in an object store is not: `Download`
/// requests the file without the key.
fn follow(attempt: Attempt<'_>) -> Action {
    match attempt.status() {
        StatusCode::TEMPORARY_REDIRECT => attempt.stop(),
        _ => Policy::default().redirect(attempt),
    }
}

/// The response to a request; a refusal becomes an error.
pub(super) async fn checked(request: RequestBuilder) -> Result<Response> {
    accepted(request.send().await?).await
}

/// The response, if it is not a refusal.
pub(super) async fn accepted(response: Response) -> Result<Response> {
    if response.status().is_success() {
        return Ok(response);
    }
    let status = response.status();
    let body = response.bytes().await?;
    Err(match serde_json::from_slice(&body) {
        Ok(problem) => ClientError::Problem(Box::new(problem)),
        Err(_) => ClientError::Unexpected(format!("status {status} without a problem document")),
    })
}

/// The response to a request, parsed as JSON.
pub(super) async fn json<T: DeserializeOwned>(request: RequestBuilder) -> Result<T> {
    let body = checked(request).await?.bytes().await?;
    serde_json::from_slice(&body).map_err(|e| ClientError::Unexpected(e.to_string()))
}
