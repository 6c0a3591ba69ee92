//! Renders on the device thread, with a cache of models and prepared lights.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Arc;

use lru::LruCache;

use crate::api::ModelId;
use crate::capture::builtin;
use crate::engine::Device;
use crate::engine::DeviceError;
use crate::formats::{environment, model_file};
use crate::render::{Frame, Output, PreparedLight, Quality, RenderError, Renderer, Viewpoint};
use crate::scene::EnvMap;

/// Why there is no frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RenderFailure {
    /// The queue is full or the device did not answer in time.
    #[error("the device is busy")]
    Busy,
    /// The request cannot be rendered.
    #[error("{field}: {reason}")]
    Refused {
        /// The request field at fault.
        field: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// The device failed; the request may be made again.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// The service failed; the text is for the log.
    #[error("{0}")]
    Internal(String),
}

impl From<RenderError> for RenderFailure {
    fn from(error: RenderError) -> Self {
        match error {
            RenderError::Refused { field, reason } => Self::Refused { field, reason },
            RenderError::Device(error) => Self::Device(error),
        }
    }
}

/// A model to render: its identifier and its file.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelSource {
    /// Identifier, the cache key: a published model never changes.
    pub id: ModelId,
    /// The model file on this machine.
    pub path: PathBuf,
}

/// A light to render under.
#[derive(Debug, Clone)]
pub enum LightSource {
    /// A map that comes with the program.
    Builtin(String),
    /// The light the model was captured under, as training recovered it.
    Recovered,
    /// An environment file on this machine, by content hash.
    Stored {
        /// Content hash, the cache key.
        sha256: String,
        /// The file.
        path: PathBuf,
    },
    /// A map that came with the request.
    Inline {
        /// Content hash, the cache key.
        sha256: String,
        /// The map.
        map: Arc<EnvMap>,
    },
}

impl LightSource {
    /// Names the light's content: equal keys, equal light on equal models.
    pub fn key(&self) -> String {
        match self {
            Self::Builtin(name) => format!("builtin:{name}"),
            Self::Recovered => "recovered".to_owned(),
            Self::Stored { sha256, .. } | Self::Inline { sha256, .. } => format!("sha256:{sha256}"),
        }
    }

    /// The map; `None` for the recovered light, which is a model's.
    ///
    /// # Errors
    /// Says why the file cannot be read.
    pub(super) fn map(&self) -> Result<Option<Arc<EnvMap>>, String> {
        match self {
            Self::Inline { map, .. } => Ok(Some(map.clone())),
            Self::Recovered => Ok(None),
            Self::Builtin(name) => {
                builtin(name).map(|map| Some(Arc::new(map))).ok_or_else(|| "is not built in".to_owned())
            }
            Self::Stored { path, .. } => {
                let bytes = std::fs::read(path).map_err(|e| e.to_string())?;
                let loaded = environment::decode(&bytes).map_err(|e| e.to_string())?;
                Ok(Some(Arc::new(loaded.map)))
            }
        }
    }
}

/// One frame to render.
#[derive(Debug, Clone)]
pub struct RenderTask {
    /// The model.
    pub model: ModelSource,
    /// The light.
    pub light: LightSource,
    /// Turn of the light about +Z, degrees counter-clockwise.
    pub rotation_deg: f64,
    /// Exposure of the light, stops.
    pub exposure_ev: f64,
    /// From where.
    pub viewpoint: Viewpoint,
    /// How.
    pub quality: Quality,
    /// What.
    pub outputs: Vec<Output>,
}

/// Model, light, rotation and exposure; floats by their bits.
type LightKey = (ModelId, String, u64, u64);

/// The models and lights that were used last.
pub(super) struct RenderCache {
    models: LruCache<ModelId, Arc<Renderer>>,
    lights: LruCache<LightKey, Arc<PreparedLight>>,
}

impl RenderCache {
    pub(super) fn new(models: usize, lights: usize) -> Self {
        let capacity = |wanted| NonZeroUsize::new(wanted).unwrap_or(NonZeroUsize::MIN);
        Self { models: LruCache::new(capacity(models)), lights: LruCache::new(capacity(lights)) }
    }

    pub(super) fn clear(&mut self) {
        self.models.clear();
        self.lights.clear();
    }

    pub(super) fn render(&mut self, task: &RenderTask, device: &Device) -> Result<Frame, RenderFailure> {
        let renderer = self.models.try_get_or_insert(task.model.id.clone(), || load(&task.model, device))?;
        let key = (
            task.model.id.clone(),
            task.light.key(),
            task.rotation_deg.to_bits(),
            task.exposure_ev.to_bits(),
        );
        let light = self.lights.try_get_or_insert(key, || prepare(renderer, task))?;
        let camera = task.viewpoint.camera(renderer.model());
        let camera = camera.map_err(|e| RenderError::Refused { field: e.field, reason: e.reason })?;
        Ok(renderer.render(&camera, light, task.quality, &task.outputs)?)
    }
}

fn load(source: &ModelSource, device: &Device) -> Result<Arc<Renderer>, RenderFailure> {
    let internal = |e: String| RenderFailure::Internal(format!("model {}: {e}", source.id));
    let bytes = std::fs::read(&source.path).map_err(|e| internal(e.to_string()))?;
    let model = model_file::decode(&bytes).map_err(|e| internal(e.to_string()))?;
    let model = Arc::new(model);
    Ok(Arc::new(match Renderer::on(model.clone(), device) {
        Err(error @ DeviceError::TooLarge { .. }) => {
            tracing::warn!(%error, model = %source.id, "the CPU engine renders this model");
            Renderer::new(model)
        }
        other => other?,
    }))
}

fn prepare(renderer: &Renderer, task: &RenderTask) -> Result<Arc<PreparedLight>, RenderFailure> {
    let internal = |e: String| RenderFailure::Internal(format!("environment {}: {e}", task.light.key()));
    let map = task.light.map().map_err(internal)?;
    let map = map.unwrap_or_else(|| Arc::new(renderer.model().environment()));
    let map = map.rotated_and_scaled(task.rotation_deg, task.exposure_ev.exp2() as f32);
    Ok(Arc::new(renderer.prepare_light(&map)?))
}
