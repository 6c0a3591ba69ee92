//! The renderer of one model.

use std::sync::{Arc, OnceLock};

use crate::render::error::RenderError;
use crate::render::high_tier_light::HighTierLight;
use crate::render::{Frame, background};
use relume_engine::{
    ColourMode, Device, DeviceError, FrameLight, FrameRenderer, HostLight, HostModel, RasterCamera,
};
use relume_scene::light::map_rows::SAMPLED_ROWS;
use relume_scene::light::{EnvSampler, LightTables, rendering_tables};
use relume_scene::{Camera, Illumination, Model, ShadeAt};
use relume_spec::rendering::{Output, Tier};

/// Greatest number of pixels of a frame.
const MAX_PIXELS: u64 = 64 << 20;

/// An environment prepared for shading a model. Preparation takes up to a second, so keep the result. It belongs to
/// the renderer that prepared it. Data for only some tiers is computed on first use.
pub struct PreparedLight {
    /// The light; its map has at most the rows that the Monte-Carlo tier uses.
    pub(super) source: Illumination,
    pub(super) frame: Box<dyn FrameLight>,
    /// The model for which the light is prepared.
    model: Arc<HostModel>,
    /// The light on the host, for computations that no other device has.
    host: OnceLock<HostLight>,
    split: OnceLock<HighTierLight>,
    sampler: OnceLock<EnvSampler>,
    whole: OnceLock<LightTables>,
}

impl PreparedLight {
    /// The environment split into its dominant lights and the rest, for visibility fields of degree `sh_degree`.
    pub(super) fn split(&self, sh_degree: usize) -> &HighTierLight {
        self.split.get_or_init(|| HighTierLight::new(&self.source.environment, sh_degree))
    }

    /// A sampler of directions by the environment's radiance.
    pub(super) fn sampler(&self) -> &EnvSampler {
        self.sampler.get_or_init(|| EnvSampler::new(self.source.environment.clone()))
    }

    /// Tables of the environment including its lights, for visibility fields of degree `sh_degree`.
    pub(super) fn whole_tables<'a>(&'a self, host: &'a HostLight, sh_degree: usize) -> &'a LightTables {
        match host.tables.lights.is_empty() {
            true => &host.tables,
            false => self.whole.get_or_init(|| rendering_tables(&self.source.environment, sh_degree)),
        }
    }
}

/// A model prepared for rendering; may be shared between threads.
pub struct Renderer {
    pub(super) frames: Arc<dyn FrameRenderer>,
    /// Height of the ground, capture units.
    pub(super) ground: OnceLock<f64>,
}

impl Renderer {
    /// A renderer of a checked model on the CPU engine.
    pub fn new(model: Arc<Model>) -> Self {
        Self { frames: Device::cpu_frames(model), ground: OnceLock::new() }
    }

    /// A renderer of a checked model on `device`.
    ///
    /// # Errors
    /// If the device cannot hold the model.
    pub fn on(model: Arc<Model>, device: &Device) -> Result<Self, DeviceError> {
        Ok(Self { frames: device.frames(model)?, ground: OnceLock::new() })
    }

    /// The model.
    pub fn model(&self) -> &Model {
        self.host().model()
    }

    /// Prepares a light for this model, including light that bounces between its surfaces: an environment map, or
    /// [`Model::recovered_light`].
    ///
    /// # Errors
    /// If the device failed.
    pub fn prepare_light(&self, light: impl Into<Illumination>) -> Result<PreparedLight, DeviceError> {
        let source = light.into();
        let frame = self.frames.clone().prepare_light(&source)?;
        Ok(PreparedLight {
            source: source.with_at_most_rows(SAMPLED_ROWS),
            frame,
            model: self.host().clone(),
            host: OnceLock::new(),
            split: OnceLock::new(),
            sampler: OnceLock::new(),
            whole: OnceLock::new(),
        })
    }

    /// The model on the host, for computations other than frames.
    pub fn host(&self) -> &Arc<HostModel> {
        self.frames.host()
    }

    /// Composites the `rgb` output of a frame of `camera` over the light.
    pub fn show_environment(&self, frame: &mut Frame, camera: &Camera, light: &PreparedLight) {
        background::show_environment(frame, camera, &light.source.environment);
    }

    /// Whether colour needs a G-buffer: not if the Gaussians are shaded and only colour is requested.
    pub(super) fn colour(&self, tier: Tier, outputs: &[Output]) -> ColourMode {
        let at_gaussians = match tier {
            Tier::Preview => true,
            Tier::Standard => self.model().shading.shade_at == ShadeAt::Gaussian,
            Tier::High | Tier::MonteCarlo => false,
        };
        match at_gaussians && outputs.iter().all(|o| matches!(o, Output::Rgb | Output::Alpha)) {
            true => ColourMode::Alone,
            false => ColourMode::WithGBuffer,
        }
    }

    /// Refuses a light of another renderer, which would show the model of that renderer.
    pub(super) fn check_light(&self, light: &PreparedLight) -> Result<(), DeviceError> {
        match Arc::ptr_eq(&light.model, self.host()) {
            true => Ok(()),
            false => Err(DeviceError::Misuse("the light was prepared by another renderer".to_owned())),
        }
    }

    /// `light` on the host; prepared on first use if another device prepared it.
    pub(super) fn light_on_host<'a>(&self, light: &'a PreparedLight) -> &'a HostLight {
        let prepare = || self.host().prepare_light(self.host().light_tables(&light.source));
        light.frame.on_host().unwrap_or_else(|| light.host.get_or_init(prepare))
    }

    /// `camera` in the form that the engines use.
    pub(super) fn view(&self, camera: &Camera) -> Result<RasterCamera, RenderError> {
        let checked = camera.validated()?;
        if u64::from(checked.width) * u64::from(checked.height) > MAX_PIXELS {
            let reason = format!("more than {MAX_PIXELS} pixels");
            return Err(RenderError::Refused { field: "width,height", reason });
        }
        let model = self.model();
        let camera = checked.in_normalised_world(model.world_scale, model.world_offset);
        Ok(RasterCamera::new(&camera, &model.shading))
    }
}
