//! Files, which a server sends or has an object store send.

use std::path::Path;

use futures::{Stream, TryStreamExt};
use reqwest::header::{ETAG, LOCATION};
use reqwest::{RequestBuilder, Response, StatusCode};
use tokio::io::AsyncWriteExt;
use tokio_util::bytes::Bytes;

use crate::connection::accepted;
use crate::error::{ClientError, Result};

/// A file on its way.
#[derive(Debug)]
pub struct Download {
    answer: Response,
    http: reqwest::Client,
}

impl Download {
    /// Asks for a file.
    pub(super) async fn begin(request: RequestBuilder) -> Result<Self> {
        let (http, request) = request.build_split();
        let answer = http.execute(request?).await?;
        let is_elsewhere = answer.status() == StatusCode::TEMPORARY_REDIRECT;
        Ok(Self { answer: if is_elsewhere { answer } else { accepted(answer).await? }, http })
    }

    /// Hash of the whole file, lower-case hex; empty where the server does not know it.
    pub fn sha256(&self) -> String {
        let etag = self.answer.headers().get(ETAG).and_then(|value| value.to_str().ok());
        etag.unwrap_or_default().trim_matches('"').to_owned()
    }

    /// The file.
    ///
    /// # Errors
    /// When the object store that has it does not send it.
    pub async fn bytes(self) -> Result<impl Stream<Item = reqwest::Result<Bytes>>> {
        Ok(self.followed().await?.bytes_stream())
    }

    /// The whole file, in memory.
    ///
    /// # Errors
    /// What failed on the way.
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

    /// The answer with the file. Nobody but the server is told the key, and nobody the URL that lets its holder in.
    async fn followed(self) -> Result<Response> {
        if self.answer.status() != StatusCode::TEMPORARY_REDIRECT {
            return Ok(self.answer);
        }
        let location = self.answer.headers().get(LOCATION).and_then(|value| value.to_str().ok());
        let there = location.and_then(|to| self.answer.url().join(to).ok());
        let there = there.ok_or_else(|| ClientError::Unexpected("a redirect to no address".to_owned()))?;
        let answer = self.http.get(there).send().await.and_then(Response::error_for_status);
        answer.map_err(|error| error.without_url().into())
    }
}
