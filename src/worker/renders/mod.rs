//! Renders frames, with a cache of models and prepared lights.

mod light_source;

use std::fmt;
use std::hash::Hash;
use std::io::ErrorKind;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lru::LruCache;

pub use light_source::{DecodedMaps, LightSource};
use relume_api::ModelId;
use relume_capture::formats::model_file;
use relume_engine::{Device, DeviceError};
use relume_scene::{Camera, Model};
use relume_spec::rendering::{Lamp, MaterialEdit, Output, Quality};
use relume_train::palette::{EditError, edited, mask};
use relume_train::render::{Frame, Neighbours, PreparedLight, RenderError, Renderer, Viewpoint};

/// Why no frame was rendered.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RenderFailure {
    /// The queue is full or the device did not answer in time.
    #[error("the device is busy")]
    Busy,
    /// The caller no longer waits.
    #[error("the caller no longer waits for the frame")]
    Abandoned,
    /// A resource of the request was deleted.
    #[error("{what} {id} no longer exists")]
    Gone {
        /// `model` or `environment`.
        what: &'static str,
        /// Its identifier, or the hash of its content.
        id: String,
    },
    /// The request cannot be rendered.
    #[error("{field}: {reason}")]
    Refused {
        /// The invalid field of the request.
        field: &'static str,
        /// The reason.
        reason: String,
    },
    /// The device failed; the request can be repeated.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// An internal error; the text is for the log.
    #[error("{0}")]
    Internal(String),
}

impl From<RenderError> for RenderFailure {
    fn from(error: RenderError) -> Self {
        match error {
            RenderError::Refused { field, reason } => Self::Refused { field, reason },
            RenderError::Abandoned => Self::Abandoned,
            RenderError::Device(error) => Self::Device(error),
        }
    }
}

/// A model to render.
#[derive(Debug, Clone)]
pub struct ModelSource {
    /// Identifier.
    pub id: ModelId,
    /// Its content.
    pub content: ModelContent,
    /// Changes of its materials.
    pub materials: MaterialChange,
}

/// What a frame shows of the materials of a model.
#[derive(Debug, Clone, PartialEq)]
pub enum MaterialChange {
    /// The model with these changes, or as it is stored if there are none.
    Edits(Vec<MaterialEdit>),
    /// A mask of one material ([`mask`]).
    Mask(u32),
}

impl MaterialChange {
    /// Applies the change.
    ///
    /// # Errors
    /// If the model does not have a material.
    pub fn apply(&self, model: Model) -> Result<Model, EditError> {
        match self {
            Self::Edits(edits) if edits.is_empty() => Ok(model),
            Self::Edits(edits) => edited(&model, edits),
            Self::Mask(material) => mask(model, *material),
        }
    }

    /// Distinguishes changes in the cache.
    fn key(&self) -> String {
        match self {
            Self::Edits(edits) if edits.is_empty() => String::new(),
            change => format!("{change:?}"),
        }
    }
}

impl ModelSource {
    /// A model as it is stored.
    pub fn new(id: ModelId, content: ModelContent) -> Self {
        Self { id, content, materials: MaterialChange::Edits(Vec::new()) }
    }

    /// The key in the cache; `None` for a model in memory, which would evict reusable entries.
    fn key(&self) -> Option<ModelKey> {
        match &self.content {
            ModelContent::File(path) => Some((path.clone(), self.materials.key())),
            ModelContent::Memory(_) => None,
        }
    }
}

/// The content of a model.
#[derive(Clone)]
pub enum ModelContent {
    /// A model file on this machine. It stays in the cache after a frame. The path is the cache key: the file at a path never
    /// changes, and a model whose files are replaced has another path.
    File(PathBuf),
    /// A model in memory, which is not cached. Changes of its materials have no effect.
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

/// One frame to render.
#[derive(Debug, Clone)]
pub struct RenderTask {
    /// The model.
    pub model: ModelSource,
    /// The light.
    pub light: LightSource,
    /// Rotation of the light about +Z, degrees counter-clockwise.
    pub rotation_deg: f64,
    /// Exposure of the light, stops.
    pub exposure_ev: f64,
    /// The camera.
    pub viewpoint: Viewpoint,
    /// Whether the light is the background.
    pub shows_environment: bool,
    /// The quality.
    pub quality: Quality,
    /// The outputs.
    pub outputs: Vec<Output>,
    /// Height of the ground, capture units; `None`: the lowest visible point of the model.
    pub ground_height: Option<f64>,
    /// Lamps beside the light. The exposure does not change them.
    pub lamps: Vec<Lamp>,
    /// The cameras before and after this one in a sequence.
    pub neighbours: Neighbours,
}

/// A light to prepare for a model, for shading in a viewer.
#[derive(Debug, Clone)]
pub struct LightTask {
    /// The model.
    pub model: ModelSource,
    /// The light.
    pub light: LightSource,
    /// Rotation of the light about +Z, degrees counter-clockwise.
    pub rotation_deg: f64,
    /// Whether the result includes an image of the light.
    pub with_map: bool,
}

impl RenderTask {
    /// The relative cost of the frame: its pixels, weighted by the tier. Lamps and the ground take longer than any single band.
    pub(super) fn cost(&self) -> u64 {
        let cost = self.pixels().saturating_mul(self.quality.pixel_cost());
        let has_more = !self.lamps.is_empty() || self.outputs.iter().any(|output| output.is_of_ground());
        if has_more { cost.max(Quality::BAND_COST + 1) } else { cost }
    }

    /// Pixels of the frame.
    pub fn pixels(&self) -> u64 {
        match &self.viewpoint {
            Viewpoint::Camera(camera) => u64::from(camera.width) * u64::from(camera.height),
            Viewpoint::Orbit(orbit) => u64::from(orbit.size) * u64::from(orbit.size),
        }
    }
}

/// Model file and the changes of its materials.
type ModelKey = (PathBuf, String);

/// Model, light, and the bits of the rotation. The exposure is not included, because the prepared light is linear in it.
type LightKey = (ModelKey, String, u64);

/// An entry of a cache. It is locked while it is made, so that two threads do not make the same entry.
type Slot<T> = Arc<Mutex<Option<Arc<T>>>>;

/// The most recently used models and lights, shared by the threads. While one thread loads a model or prepares a light, the
/// others can use finished entries.
pub(super) struct RenderCache {
    models: Mutex<LruCache<ModelKey, Slot<Renderer>>>,
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

    /// The scene of a task. Stops between loading and preparation if the result is no longer wanted.
    pub(super) fn scene(
        &self,
        task: &RenderTask,
        device: &Device,
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<RenderScene, RenderFailure> {
        let renderer = self.model(&task.model, device, is_wanted)?;
        let camera = task.viewpoint.camera(renderer.model()).map_err(RenderError::from)?;
        let light = self.light(&renderer, &task.model, (&task.light, task.rotation_deg), is_wanted)?;
        Ok(RenderScene { lit: LitModel { renderer, light }, camera })
    }

    /// The model and light of a task. Stops as [`Self::scene`] does.
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
        let Some(key) = source.key() else { return load(source, device) };
        let renderer = get_or_make(&self.models, &key, || load(source, device))?;
        self.drop_lights_of_evicted_models();
        Ok(renderer)
    }

    /// Removes the lights of models that are no longer cached, because a light keeps its model in memory.
    fn drop_lights_of_evicted_models(&self) {
        let (models, mut lights) = (lock(&self.models), lock(&self.lights));
        let is_evicted = |(model, ..): &LightKey| !models.contains(model);
        let evicted: Vec<LightKey> =
            lights.iter().map(|(key, _)| key).filter(|key| is_evicted(key)).cloned().collect();
        for key in evicted {
            lights.pop(&key);
        }
    }

    fn light(
        &self,
        renderer: &Renderer,
        model: &ModelSource,
        (light, rotation_deg): (&LightSource, f64),
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<Arc<PreparedLight>, RenderFailure> {
        check_wanted(is_wanted)?;
        let Some(model) = model.key() else { return prepare(renderer, light, rotation_deg) };
        let key = (model, light.key(), rotation_deg.to_bits());
        let light = get_or_make(&self.lights, &key, || prepare(renderer, light, rotation_deg))?;
        check_wanted(is_wanted)?;
        Ok(light)
    }
}

/// The entry of `key`. The cache is not locked while `make` runs. A failed entry is not kept.
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

/// Locks a mutex. After a panic the cache is still valid and the entry is empty.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn check_wanted(is_wanted: &dyn Fn() -> bool) -> Result<(), RenderFailure> {
    if is_wanted() { Ok(()) } else { Err(RenderFailure::Abandoned) }
}

/// A model under a light, independent of the cache.
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

/// A model under a light, with a camera.
pub(super) struct RenderScene {
    lit: LitModel,
    camera: Camera,
}

impl RenderScene {
    /// Renders the frame of `task`. `between` is called between the bands of an expensive frame and can stop it.
    pub(super) fn render(
        &self,
        task: &RenderTask,
        mut between: impl FnMut() -> Result<(), RenderFailure>,
    ) -> Result<Frame, RenderFailure> {
        let _span = tracing::info_span!("draw", tier = task.quality.tier.name()).entered();
        let LitModel { renderer, light } = &self.lit;
        let bands = renderer.bands(&self.camera, light, task.quality, &task.outputs)?;
        let bands = bands.on_ground(task.ground_height).between(task.neighbours);
        let mut bands = bands.with_lamps(lamps_before_exposure(task));
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

/// The lamps of a task such that its exposure, which changes the whole frame, gives them their intensity.
fn lamps_before_exposure(task: &RenderTask) -> Vec<Lamp> {
    task.lamps.iter().map(|lamp| lamp.scaled((-task.exposure_ev).exp2())).collect()
}

/// Applies an exposure to a frame. A frame is linear in the light, so the exposure is a factor.
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
        ModelContent::File(path) => {
            let model = source.materials.apply(read(path, &source.id)?);
            let refused =
                |error: EditError| RenderFailure::Refused { field: "materials", reason: error.to_string() };
            Arc::new(model.map_err(refused)?)
        }
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
    let illumination = light.illumination(renderer.model()).map_err(|error| match light {
        LightSource::Stored { path, sha256, .. } if !path.exists() => {
            RenderFailure::Gone { what: "environment", id: sha256.clone() }
        }
        LightSource::RecoveredGroup(_) => RenderFailure::Refused { field: "environment", reason: error },
        _ => internal(error),
    })?;
    Ok(Arc::new(renderer.prepare_light(illumination.rotated_and_scaled(rotation_deg, 1.0))?))
}

#[cfg(test)]
mod tests;
