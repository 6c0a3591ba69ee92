//! Deletion.

use reqwest::Method;

use crate::connection::{Client, checked};
use crate::error::Result;
use relume_api::{CaptureId, EnvironmentId, JobId, ModelId};

impl Client {
    /// Deletes a capture; with `cascade` also the jobs that use it.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused and names the jobs that use it, or the request failed.
    pub async fn delete_capture(&self, id: &CaptureId, cascade: bool) -> Result<()> {
        self.delete(&format!("/v1/captures/{id}"), cascade).await
    }

    /// Deletes an environment map; with `cascade` also the jobs that use it.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused and names the jobs that use it, or the request failed.
    pub async fn delete_environment(&self, id: &EnvironmentId, cascade: bool) -> Result<()> {
        self.delete(&format!("/v1/environments/{id}"), cascade).await
    }

    /// Deletes a job. With `cascade` a running job is cancelled and deleted. The job's model is kept.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn delete_job(&self, id: &JobId, cascade: bool) -> Result<()> {
        self.delete(&format!("/v1/jobs/{id}"), cascade).await
    }

    /// Deletes a model. Its job is kept.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn delete_model(&self, id: &ModelId) -> Result<()> {
        self.delete(&format!("/v1/models/{id}"), false).await
    }

    async fn delete(&self, path: &str, cascade: bool) -> Result<()> {
        let path = if cascade { format!("{path}?cascade=true") } else { path.to_owned() };
        checked(self.request(Method::DELETE, &path)?).await.map(drop)
    }
}
