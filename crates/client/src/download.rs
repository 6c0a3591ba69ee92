//! Downloads files from the server, or from the object store to which it redirects.

use std::path::Path;

use futures::{Stream, TryStreamExt};
use reqwest::header::{ETAG, LOCATION};
use reqwest::{RequestBuilder, Response, StatusCode};
use tokio::io::AsyncWriteExt;
use tokio_util::bytes::Bytes;

use crate::connection::accepted;
use crate::error::{ClientError, Result};

/// A started download.
#[derive(Debug)]
pub struct Download {
    answer: Response,
    http: reqwest::Client,
}

impl Download {
    /// Requests a file.
    pub(super) async fn begin(request: RequestBuilder) -> Result<Self> {
        let (http, request) = request.build_split();
        let answer = http.execute(request?).await?;
        let is_elsewhere = answer.status() == StatusCode::TEMPORARY_REDIRECT;
        Ok(Self { answer: if is_elsewhere { answer } else { accepted(answer).await? }, http })
    }

    /// SHA-256 of the complete file, lower-case hex; empty if the server does not know it.
    pub fn sha256(&self) -> String {
        let etag = self.answer.headers().get(ETAG).and_then(|value| value.to_str().ok());
        etag.unwrap_or_default().trim_matches('"').to_owned()
    }

    /// The contents of the file as a stream.
    ///
    /// # Errors
    /// If the object store does not send the file.
    pub async fn bytes(self) -> Result<impl Stream<Item = reqwest::Result<Bytes>>> {
        Ok(self.followed().await?.bytes_stream())
    }

    /// The complete file in memory.
    ///
    /// # Errors
    /// [`ClientError`]: the download failed.
    pub async fn whole(self) -> Result<Bytes> {
        Ok(self.followed().await?.bytes().await?)
    }

    /// Writes the file to `path`.
    pub(super) async fn save(self, path: &Path) -> Result<()> {
        let mut body = self.followed().await?.bytes_stream();
        let mut file = tokio::fs::File::create(path).await?;
        while let Some(chunk) = body.try_next().await? {
            file.write_all(&chunk).await?;
        }
        Ok(file.sync_all().await?)
    }

    /// The response with the file. The API key is sent only to the server, and errors do not contain the signed URL
    /// of an object store.
    async fn followed(self) -> Result<Response> {
        if self.answer.status() != StatusCode::TEMPORARY_REDIRECT {
            return Ok(self.answer);
        }
        let location = self.answer.headers().get(LOCATION).and_then(|value| value.to_str().ok());
        let there = location.and_then(|to| self.answer.url().join(to).ok());
        let there =
            there.ok_or_else(|| ClientError::Unexpected("a redirect without a valid address".to_owned()))?;
        let answer = self.http.get(there).send().await.and_then(Response::error_for_status);
        answer.map_err(|error| error.without_url().into())
    }
}
