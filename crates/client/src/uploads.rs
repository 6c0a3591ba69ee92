//! Resumable uploads in chunks.

use reqwest::header::{CONTENT_TYPE, LOCATION};
use reqwest::{Method, RequestBuilder, Response};

use crate::connection::{Client, checked, json};
use crate::error::{ClientError, Result};
use relume_api::captures::CaptureSummary;
use relume_api::uploads::{CaptureSource, UploadView};
use relume_api::{List, UploadId};

impl Client {
    /// Starts an upload of `length` bytes.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn begin_upload(&self, length: u64) -> Result<UploadId> {
        let request = self.tus(Method::POST, "/v1/uploads")?.header("upload-length", length);
        let response = checked(request).await?;
        let location = response.headers().get(LOCATION).and_then(|value| value.to_str().ok());
        let id = location.and_then(|text| text.rsplit('/').next()).map(UploadId::from);
        id.ok_or_else(|| ClientError::Unexpected("the upload has no Location".to_owned()))
    }

    /// The state of an upload, including the number of received bytes.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn upload(&self, id: &UploadId) -> Result<UploadView> {
        json(self.request(Method::GET, &format!("/v1/uploads/{id}"))?).await
    }

    /// The newest uploads that are not yet captures.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn uploads(&self) -> Result<List<UploadView>> {
        json(self.request(Method::GET, "/v1/uploads")?).await
    }

    /// Sends a chunk that starts at `offset`; returns the new offset of the upload.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed and part of the chunk may have been
    /// received.
    pub async fn send_piece(
        &self,
        id: &UploadId,
        offset: u64,
        piece: impl Into<reqwest::Body>,
    ) -> Result<u64> {
        let request = self.tus(Method::PATCH, &format!("/v1/uploads/{id}"))?;
        let request =
            request.header(CONTENT_TYPE, "application/offset+octet-stream").header("upload-offset", offset);
        offset_of(&checked(request.body(piece)).await?)
    }

    /// Creates a capture from a complete upload, which is then removed.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn capture_of_upload(&self, id: &UploadId) -> Result<CaptureSummary> {
        self.capture_of(&CaptureSource::upload(id.clone())).await
    }

    /// Creates a capture from a complete upload, or from a file that the server fetches.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn capture_of(&self, source: &CaptureSource) -> Result<CaptureSummary> {
        json(self.request(Method::POST, "/v1/captures")?.json(source)).await
    }

    /// Cancels an upload.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn delete_upload(&self, id: &UploadId) -> Result<()> {
        checked(self.tus(Method::DELETE, &format!("/v1/uploads/{id}"))?).await.map(drop)
    }

    fn tus(&self, method: Method, path: &str) -> Result<RequestBuilder> {
        Ok(self.request(method, path)?.header("tus-resumable", "1.0.0"))
    }
}

fn offset_of(response: &Response) -> Result<u64> {
    let offset = response.headers().get("upload-offset").and_then(|value| value.to_str().ok());
    let offset = offset.and_then(|text| text.parse().ok());
    offset.ok_or_else(|| ClientError::Unexpected("the upload has no valid Upload-Offset".to_owned()))
}
