//! Captures.

use std::path::Path;

use reqwest::Method;
use reqwest::header::{CONTENT_LENGTH, CONTENT_TYPE};
use serde::de::DeserializeOwned;
use tokio_util::bytes::Bytes;

use crate::connection::{Client, checked, json};
use crate::error::Result;
use relume_api::cameras::{CameraConvention, CaptureCameras};
use relume_api::captures::CaptureSummary;
use relume_api::metadata::MetadataChange;
use relume_api::photographs::{CapturePhotographs, CapturedPhotograph};
use relume_api::{CaptureId, List};
use relume_spec::CaptureReport;

impl Client {
    /// Uploads a zip, tar or tar.gz, streamed from disk.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn upload_capture(&self, archive: &Path) -> Result<CaptureSummary> {
        let file = tokio::fs::File::open(archive).await?;
        let length = file.metadata().await?.len();
        let body = reqwest::Body::wrap_stream(tokio_util::io::ReaderStream::new(file));
        self.post_archive("/v1/captures", body, Some(length)).await
    }

    /// Uploads an archive from memory.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn upload_capture_bytes(&self, archive: impl Into<Bytes>) -> Result<CaptureSummary> {
        self.post_archive("/v1/captures", archive.into().into(), None).await
    }

    /// Validates an archive as an upload would, without storing it.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
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
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn capture(&self, id: &CaptureId) -> Result<CaptureSummary> {
        json(self.request(Method::GET, &format!("/v1/captures/{id}"))?).await
    }

    /// The cameras of a capture's photographs.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn capture_cameras(
        &self,
        id: &CaptureId,
        convention: CameraConvention,
    ) -> Result<CaptureCameras> {
        let path = format!("/v1/captures/{id}/cameras?convention={}", convention.name());
        json(self.request(Method::GET, &path)?).await
    }

    /// A capture's photographs, each with its camera and the findings of the validation.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn capture_photographs(
        &self,
        id: &CaptureId,
        convention: CameraConvention,
    ) -> Result<CapturePhotographs> {
        let path = format!("/v1/captures/{id}/photographs?convention={}", convention.name());
        json(self.request(Method::GET, &path)?).await
    }

    /// A photograph of a capture as a JPEG; `query` as in the API, e.g. `width=320&undistorted=true`.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn capture_photograph(&self, photograph: &CapturedPhotograph, query: &str) -> Result<Bytes> {
        let request = self.request(Method::GET, &format!("{}?{query}", photograph.href))?;
        Ok(checked(request).await?.bytes().await?)
    }

    /// COLMAP's log of the poses of a capture's photographs; empty for captures that were uploaded with poses.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn capture_log(&self, id: &CaptureId) -> Result<String> {
        let request = self.request(Method::GET, &format!("/v1/captures/{id}/log"))?;
        Ok(checked(request).await?.text().await?)
    }

    /// Changes the metadata of a capture.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn change_capture(&self, id: &CaptureId, change: &MetadataChange) -> Result<CaptureSummary> {
        json(self.request(Method::PATCH, &format!("/v1/captures/{id}"))?.json(change)).await
    }

    /// The newest captures.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn captures(&self) -> Result<List<CaptureSummary>> {
        json(self.request(Method::GET, "/v1/captures")?).await
    }
}
