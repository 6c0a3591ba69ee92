//! The renderer a service keeps per model.

use std::sync::{Arc, OnceLock};

use crate::render::background;
use crate::render::error::RenderError;
use crate::render::high::HighTierLight;
use crate::render::{Frame, monte_carlo};
use relume_engine::cpu::{CpuFrameLight as CpuLight, OccluderBvh};
use relume_engine::{ColourMode, Device, DeviceError, FrameLight, FrameRenderer, RasterCamera};
use relume_scene::light::{EnvSampler, LightTables, rendering_tables};
use relume_scene::{Camera, Illumination, Model, ShadeAt};
use relume_spec::rendering::{Output, Tier};

/// Most pixels of a frame.
const MAX_PIXELS: u64 = 64 << 20;

/// An environment turned into what a model is shaded with; costs a second at most, keep it. Belongs to the renderer
/// that prepared it. What only some tiers need is made when the first of them asks.
pub struct PreparedLight {
    /// The light itself; its map has at most the rows that the Monte-Carlo tier uses.
    pub(super) source: Illumination,
    pub(super) frame: FrameLight,
    split: OnceLock<HighTierLight>,
    sampler: OnceLock<EnvSampler>,
    whole: OnceLock<LightTables>,
}

impl PreparedLight {
    /// The environment with its dominant lights taken out, for visibility fields of degree `sh_degree`.
    pub(super) fn split(&self, sh_degree: usize) -> &HighTierLight {
        self.split.get_or_init(|| HighTierLight::new(&self.source.environment, sh_degree))
    }

    /// What draws directions by the environment's radiance.
    pub(super) fn sampler(&self) -> &EnvSampler {
        self.sampler.get_or_init(|| EnvSampler::new(self.source.environment.clone()))
    }

    /// Tables of the environment with no lights beside them, for visibility fields of degree `sh_degree`.
    pub(super) fn whole_tables<'a>(&'a self, on_cpu: &'a CpuLight, sh_degree: usize) -> &'a LightTables {
        match on_cpu.tables.lights.is_empty() {
            true => &on_cpu.tables,
            false => self.whole.get_or_init(|| rendering_tables(&self.source.environment, sh_degree)),
        }
    }
}

/// A model ready to be rendered many times. Shared between threads.
pub struct Renderer {
    pub(super) frames: FrameRenderer,
}

impl Renderer {
    /// Takes a checked model in, to be rendered on the CPU engine.
    pub fn new(model: Arc<Model>) -> Self {
        Self { frames: FrameRenderer::on_cpu_only(model) }
    }

    /// Takes a checked model in, to be rendered on `device`.
    ///
    /// # Errors
    /// When the device cannot hold the model.
    pub fn on(model: Arc<Model>, device: &Device) -> Result<Self, DeviceError> {
        Ok(Self { frames: device.frames(model)? })
    }

    /// The model.
    pub fn model(&self) -> &Model {
        self.frames.model()
    }

    /// Makes a light ready for this model, light that bounces between its surfaces included: an environment map, or
    /// [`Model::recovered_light`].
    ///
    /// # Errors
    /// When the device failed.
    pub fn prepare_light(&self, light: impl Into<Illumination>) -> Result<PreparedLight, DeviceError> {
        let source = light.into();
        let frame = self.frames.prepare_light(&source)?;
        Ok(PreparedLight {
            source: source.with_at_most_rows(monte_carlo::MAX_ROWS),
            frame,
            split: OnceLock::new(),
            sampler: OnceLock::new(),
            whole: OnceLock::new(),
        })
    }

    /// What hides what, as the Monte-Carlo tier asks it.
    pub fn occluders(&self) -> &OccluderBvh {
        self.frames.on_cpu().occluders()
    }

    /// Puts the light behind what `rgb` shows of a frame of `camera`.
    pub fn show_environment(&self, frame: &mut Frame, camera: &Camera, light: &PreparedLight) {
        background::show_environment(frame, camera, &light.source.environment);
    }

    /// Where Gaussians are shaded, colour alone needs no G-buffer; anything else does, in every tier.
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

    pub(super) fn light_on_cpu<'a>(&self, light: &'a PreparedLight) -> &'a CpuLight {
        self.frames.light_on_cpu(&light.frame, &light.source)
    }

    /// `camera` as the engines want it.
    pub(super) fn view(&self, camera: &Camera) -> Result<RasterCamera, RenderError> {
        let checked =
            camera.validated().map_err(|e| RenderError::Refused { field: e.field, reason: e.reason })?;
        if u64::from(checked.width) * u64::from(checked.height) > MAX_PIXELS {
            let reason = format!("more than {MAX_PIXELS} pixels");
            return Err(RenderError::Refused { field: "width,height", reason });
        }
        let model = self.model();
        let camera = checked.in_normalised_world(model.world_scale, model.world_offset);
        Ok(RasterCamera::new(&camera, &model.shading))
    }
}
