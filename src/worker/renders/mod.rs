//! Renders on the thread of frames, with a cache of models and prepared lights.

use std::fmt;
use std::hash::Hash;
use std::io::ErrorKind;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lru::LruCache;

use relume_api::ModelId;
use relume_capture::builtin;
use relume_capture::formats::{environment, model_file};
use relume_engine::Device;
use relume_engine::DeviceError;
use relume_scene::{Camera, EnvMap, Illumination, Model};
use relume_spec::rendering::{Output, Quality};
use relume_train::render::{Frame, PreparedLight, RenderError, Renderer, Viewpoint};

/// Why there is no frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RenderFailure {
    /// The queue is full or the device did not answer in time.
    #[error("the device is busy")]
    Busy,
    /// The caller does not wait any more.
    #[error("nobody waits for the frame")]
    Abandoned,
    /// What was asked for has been deleted.
    #[error("{what} {id} is gone")]
    Gone {
        /// A model or an environment.
        what: &'static str,
        /// Its identifier, or the hash of its content.
        id: String,
    },
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

/// A model to render.
#[derive(Debug, Clone)]
pub struct ModelSource {
    /// Identifier; of a file also the cache key: a published model never changes.
    pub id: ModelId,
    /// Where it is.
    pub content: ModelContent,
}

/// Where a model is.
#[derive(Clone)]
pub enum ModelContent {
    /// In a model file on this machine; it stays ready after a frame.
    File(PathBuf),
    /// In memory, for a frame or two.
    Memory(Arc<Model>),
}

impl fmt::Debug for ModelContent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => write!(f, "{}", path.display()),
            Self::Memory(model) => write!(f, "{} Gaussians in memory", model.gaussians.len()),
        }
    }
}

/// Most rows of a map that frames are made of: texels of 0.18 degrees, a third of the sun.
const MAX_MAP_ROWS: usize = 1024;

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

    /// A map as small as it makes no difference to any tier.
    pub fn downscaled(map: EnvMap) -> EnvMap {
        map.at_most_rows(MAX_MAP_ROWS)
    }

    /// The map; `None` for the recovered light, which is a model's.
    ///
    /// # Errors
    /// Says why the file cannot be read.
    pub fn map(&self) -> Result<Option<Arc<EnvMap>>, String> {
        match self {
            Self::Inline { map, .. } => Ok(Some(map.clone())),
            Self::Recovered => Ok(None),
            Self::Builtin(name) => {
                builtin(name).map(|map| Some(Arc::new(map))).ok_or_else(|| "is not built in".to_owned())
            }
            Self::Stored { path, .. } => {
                let bytes = std::fs::read(path).map_err(|e| e.to_string())?;
                let loaded = environment::decode(&bytes).map_err(|e| e.to_string())?;
                Ok(Some(Arc::new(Self::downscaled(loaded.map))))
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
    /// Whether the light shows behind the model.
    pub shows_environment: bool,
    /// How.
    pub quality: Quality,
    /// What.
    pub outputs: Vec<Output>,
}

/// A light to make ready for a model, to be shaded with elsewhere.
#[derive(Debug, Clone)]
pub struct LightTask {
    /// The model.
    pub model: ModelSource,
    /// The light.
    pub light: LightSource,
    /// Turn of the light about +Z, degrees counter-clockwise.
    pub rotation_deg: f64,
    /// Whether a picture of the light comes with it.
    pub with_map: bool,
}

impl RenderTask {
    /// What the frame costs on the device beside others: its pixels, weighed by the tier.
    pub(super) fn cost(&self) -> u64 {
        self.pixels().saturating_mul(self.quality.pixel_cost())
    }

    /// Pixels of the frame.
    pub fn pixels(&self) -> u64 {
        match &self.viewpoint {
            Viewpoint::Camera(camera) => u64::from(camera.width) * u64::from(camera.height),
            Viewpoint::Orbit(orbit) => u64::from(orbit.size) * u64::from(orbit.size),
        }
    }
}

/// Model, light and rotation by its bits. Not the exposure: it is a factor on what the light makes.
type LightKey = (ModelId, String, u64);

/// An entry of a cache. Its lock is held while the entry is made, so that two threads do not make the same one.
type Slot<T> = Arc<Mutex<Option<Arc<T>>>>;

/// The models and lights that were used last. Threads share it: while one loads a model or prepares a light, the others find
/// what is ready.
pub(super) struct RenderCache {
    models: Mutex<LruCache<ModelId, Slot<Renderer>>>,
    lights: Mutex<LruCache<LightKey, Slot<PreparedLight>>>,
}

impl RenderCache {
    pub(super) fn new(models: usize, lights: usize) -> Self {
        let capacity = |wanted| NonZeroUsize::new(wanted).unwrap_or(NonZeroUsize::MIN);
        let (models, lights) = (LruCache::new(capacity(models)), LruCache::new(capacity(lights)));
        Self { models: Mutex::new(models), lights: Mutex::new(lights) }
    }

    pub(super) fn clear(&self) {
        lock(&self.models).clear();
        lock(&self.lights).clear();
    }

    /// What a task shows; gives up between loading and preparing when it is not wanted any more.
    pub(super) fn scene(
        &self,
        task: &RenderTask,
        device: &Device,
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<RenderScene, RenderFailure> {
        let renderer = self.model(&task.model, device, is_wanted)?;
        let camera = task.viewpoint.camera(renderer.model());
        let camera = camera.map_err(|e| RenderError::Refused { field: e.field, reason: e.reason })?;
        let light = self.light(&renderer, &task.model, (&task.light, task.rotation_deg), is_wanted)?;
        Ok(RenderScene { lit: LitModel { renderer, light }, camera })
    }

    /// The model and the light of a task; gives up likewise.
    pub(super) fn lit_model(
        &self,
        task: &LightTask,
        device: &Device,
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<LitModel, RenderFailure> {
        let renderer = self.model(&task.model, device, is_wanted)?;
        let light = self.light(&renderer, &task.model, (&task.light, task.rotation_deg), is_wanted)?;
        Ok(LitModel { renderer, light })
    }

    fn model(
        &self,
        source: &ModelSource,
        device: &Device,
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<Arc<Renderer>, RenderFailure> {
        check_wanted(is_wanted)?;
        // One in memory would drive out those that are asked for again.
        if let ModelContent::Memory(_) = source.content {
            return load(source, device);
        }
        get_or_make(&self.models, &source.id, || load(source, device))
    }

    fn light(
        &self,
        renderer: &Renderer,
        model: &ModelSource,
        (light, rotation_deg): (&LightSource, f64),
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<Arc<PreparedLight>, RenderFailure> {
        check_wanted(is_wanted)?;
        if let ModelContent::Memory(_) = model.content {
            return prepare(renderer, light, rotation_deg);
        }
        let key = (model.id.clone(), light.key(), rotation_deg.to_bits());
        let light = get_or_make(&self.lights, &key, || prepare(renderer, light, rotation_deg))?;
        check_wanted(is_wanted)?;
        Ok(light)
    }
}

/// The entry of `key`. The cache is not locked while `make` runs; an entry that could not be made is not kept.
fn get_or_make<K: Clone + Eq + Hash, T>(
    cache: &Mutex<LruCache<K, Slot<T>>>,
    key: &K,
    make: impl FnOnce() -> Result<Arc<T>, RenderFailure>,
) -> Result<Arc<T>, RenderFailure> {
    let slot = lock(cache).get_or_insert(key.clone(), Slot::default).clone();
    let mut entry = lock(&slot);
    if let Some(ready) = &*entry {
        return Ok(ready.clone());
    }
    match make() {
        Ok(made) => Ok(entry.insert(made).clone()),
        Err(failure) => {
            let mut cache = lock(cache);
            if cache.peek(key).is_some_and(|kept| Arc::ptr_eq(kept, &slot)) {
                cache.pop(key);
            }
            Err(failure)
        }
    }
}

/// Locks; a thread that panicked leaves a cache whole and an entry empty.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn check_wanted(is_wanted: &dyn Fn() -> bool) -> Result<(), RenderFailure> {
    if is_wanted() { Ok(()) } else { Err(RenderFailure::Abandoned) }
}

/// A model under a light. Holds nothing of the cache.
pub(super) struct LitModel {
    renderer: Arc<Renderer>,
    light: Arc<PreparedLight>,
}

impl LitModel {
    /// The stream of the light for viewers.
    pub(super) fn stream(&self, with_map: bool) -> Vec<u8> {
        self.renderer.stream_light(&self.light, with_map)
    }
}

/// The same before a camera.
pub(super) struct RenderScene {
    lit: LitModel,
    camera: Camera,
}

impl RenderScene {
    /// The frame of `task`. `between` is called between the bands of a dear one, and may end it.
    pub(super) fn render(
        &self,
        task: &RenderTask,
        mut between: impl FnMut() -> Result<(), RenderFailure>,
    ) -> Result<Frame, RenderFailure> {
        let _span = tracing::info_span!("draw", tier = task.quality.tier.name()).entered();
        let LitModel { renderer, light } = &self.lit;
        let mut bands = renderer.bands(&self.camera, light, task.quality, &task.outputs)?;
        while bands.render_next()? {
            between()?;
        }
        let mut frame = bands.into_frame();
        if task.shows_environment {
            renderer.show_environment(&mut frame, &self.camera, light);
        }
        expose(&mut frame, task.exposure_ev);
        Ok(frame)
    }
}

/// Scales what the light makes in a frame. All of it is linear in the light, so that the exposure of the light is a factor.
fn expose(frame: &mut Frame, stops: f64) {
    if stops == 0.0 {
        return;
    }
    let gain = stops.exp2() as f32;
    for output in [Output::Rgb, Output::Diffuse, Output::Specular] {
        let plane = frame.planes.get_mut(&output).into_iter().flatten();
        plane.for_each(|value| *value = (*value * gain).min(f32::MAX));
    }
}

fn load(source: &ModelSource, device: &Device) -> Result<Arc<Renderer>, RenderFailure> {
    let _span = tracing::info_span!("load_model", model = %source.id).entered();
    let model = match &source.content {
        ModelContent::File(path) => Arc::new(read(path, &source.id)?),
        ModelContent::Memory(model) => model.clone(),
    };
    Ok(Arc::new(match Renderer::on(model.clone(), device) {
        Err(error @ DeviceError::TooLarge { .. }) => {
            tracing::warn!(%error, model = %source.id, "the CPU engine renders this model");
            Renderer::new(model)
        }
        other => other?,
    }))
}

fn read(path: &Path, id: &ModelId) -> Result<Model, RenderFailure> {
    let internal = |e: String| RenderFailure::Internal(format!("model {id}: {e}"));
    let bytes = std::fs::read(path).map_err(|e| match e.kind() {
        ErrorKind::NotFound => RenderFailure::Gone { what: "model", id: id.to_string() },
        _ => internal(e.to_string()),
    })?;
    model_file::decode(&bytes).map_err(|e| internal(e.to_string()))
}

fn prepare(
    renderer: &Renderer,
    light: &LightSource,
    rotation_deg: f64,
) -> Result<Arc<PreparedLight>, RenderFailure> {
    let _span = tracing::info_span!("prepare_light", light = light.key()).entered();
    let internal = |e: String| RenderFailure::Internal(format!("environment {}: {e}", light.key()));
    let map = light.map().map_err(|error| match light {
        LightSource::Stored { path, sha256 } if !path.exists() => {
            RenderFailure::Gone { what: "environment", id: sha256.clone() }
        }
        _ => internal(error),
    })?;
    let light = map.map_or_else(|| renderer.model().recovered_light(), |map| Illumination::from(&*map));
    let light = match rotation_deg {
        0.0 => light,
        turn => light.rotated_and_scaled(turn, 1.0),
    };
    Ok(Arc::new(renderer.prepare_light(light)?))
}

#[cfg(test)]
mod tests;
