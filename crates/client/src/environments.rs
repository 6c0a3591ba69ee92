//! Environment maps.

use reqwest::Method;
use reqwest::header::CONTENT_TYPE;
use tokio_util::bytes::Bytes;

use crate::connection::{Client, json};
use crate::error::Result;
use relume_api::EnvironmentId;
use relume_api::environments::{EnvironmentList, EnvironmentView};
use relume_api::metadata::MetadataChange;

impl Client {
    /// Uploads an HDR environment map.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn upload_environment(&self, file: impl Into<Bytes>) -> Result<EnvironmentView> {
        let request = self.request(Method::POST, "/v1/environments")?;
        json(request.header(CONTENT_TYPE, "application/octet-stream").body(file.into())).await
    }

    /// Changes the metadata of an environment map.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn change_environment(
        &self,
        id: &EnvironmentId,
        change: &MetadataChange,
    ) -> Result<EnvironmentView> {
        json(self.request(Method::PATCH, &format!("/v1/environments/{id}"))?.json(change)).await
    }

    /// Built-in and uploaded environment maps.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn environments(&self) -> Result<EnvironmentList> {
        json(self.request(Method::GET, "/v1/environments")?).await
    }
}
