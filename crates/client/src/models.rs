//! Models, their files and frames.

use std::path::Path;

use reqwest::Method;
use reqwest::header::ACCEPT;
use tokio_util::bytes::Bytes;

use crate::connection::{Client, checked, json};
use crate::download::Download;
use crate::error::Result;
use relume_api::calibration::NewCalibration;
use relume_api::materials::MaterialView;
use relume_api::metadata::MetadataChange;
use relume_api::models::{ModelSummary, ModelView};
use relume_api::next_photographs::{NextPhotographs, NextPhotographsRequest};
use relume_api::renders::RenderRequest;
use relume_api::{List, ModelId};
use relume_spec::rendering::FrameFormat;

impl Client {
    /// A model with its files and its card.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn model(&self, id: &ModelId) -> Result<ModelView> {
        json(self.request(Method::GET, &format!("/v1/models/{id}"))?).await
    }

    /// Changes the metadata of a model.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn change_model(&self, id: &ModelId, change: &MetadataChange) -> Result<ModelSummary> {
        json(self.request(Method::PATCH, &format!("/v1/models/{id}"))?.json(change)).await
    }

    /// Scales the albedo of a model to a surface of known reflectance. The files of the model change.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn calibrate(&self, id: &ModelId, calibration: &NewCalibration) -> Result<ModelView> {
        json(self.request(Method::PUT, &format!("/v1/models/{id}/calibration"))?.json(calibration)).await
    }

    /// Undoes all calibrations of a model since its training.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn undo_calibration(&self, id: &ModelId) -> Result<ModelView> {
        json(self.request(Method::DELETE, &format!("/v1/models/{id}/calibration"))?).await
    }

    /// The materials of a model, in the order of their numbers.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn materials(&self, id: &ModelId) -> Result<List<MaterialView>> {
        json(self.request(Method::GET, &format!("/v1/models/{id}/materials"))?).await
    }

    /// The places from which further photographs would help a model most.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn next_photographs(
        &self,
        id: &ModelId,
        request: &NextPhotographsRequest,
    ) -> Result<NextPhotographs> {
        let path = format!("/v1/models/{id}/next-photographs");
        json(self.request(Method::POST, &path)?.json(request)).await
    }

    /// The newest models.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn models(&self) -> Result<List<ModelSummary>> {
        json(self.request(Method::GET, "/v1/models")?).await
    }

    /// A file of a model in memory.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn file(&self, model: &ModelId, name: &str) -> Result<Bytes> {
        let request = self.request(Method::GET, &format!("/v1/models/{model}/files/{name}"))?;
        Download::begin(request).await?.whole().await
    }

    /// Downloads a file of a model to `path`.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed; an incomplete file may remain at `path`.
    pub async fn download(&self, model: &ModelId, name: &str, path: &Path) -> Result<()> {
        let request = self.request(Method::GET, &format!("/v1/models/{model}/files/{name}"))?;
        Download::begin(request).await?.save(path).await
    }

    /// A rendered frame as an image file.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn render(
        &self,
        model: &ModelId,
        request: &RenderRequest,
        format: FrameFormat,
    ) -> Result<Bytes> {
        let post = self.request(Method::POST, &format!("/v1/models/{model}/render"))?;
        let response = checked(post.header(ACCEPT, format.media_type()).json(request)).await?;
        Ok(response.bytes().await?)
    }

    /// A model's stream for viewers (docs/viewer-stream.md).
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn viewer_stream(&self, model: &ModelId) -> Result<Bytes> {
        let request = self.request(Method::GET, &format!("/v1/models/{model}/stream"))?;
        Ok(checked(request).await?.bytes().await?)
    }

    /// A light's stream for viewers of a model; `query` as in the API, e.g. `environment=studio&rotation=30`.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn viewer_light(&self, model: &ModelId, query: &str) -> Result<Bytes> {
        let request = self.request(Method::GET, &format!("/v1/models/{model}/light?{query}"))?;
        Ok(checked(request).await?.bytes().await?)
    }

    /// A thumbnail; `query` as in the API, e.g. `env=studio&size=128`.
    ///
    /// # Errors
    /// [`crate::ClientError`]: the server refused the request, or it failed.
    pub async fn thumbnail(&self, model: &ModelId, query: &str) -> Result<Bytes> {
        let request = self.request(Method::GET, &format!("/v1/models/{model}/thumbnail?{query}"))?;
        Ok(checked(request).await?.bytes().await?)
    }
}
