//! The renderer of one model.

use std::sync::{Arc, OnceLock};

use crate::render::Frame;
use crate::render::background;
use crate::render::error::RenderError;
use crate::render::high_tier_light::HighTierLight;
use relume_engine::cpu::{CpuFrameLight as CpuLight, OccluderBvh};
use relume_engine::{ColourMode, Device, DeviceError, FrameLight, FrameRenderer, RasterCamera};
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
    pub(super) frame: FrameLight,
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
    pub(super) fn whole_tables<'a>(&'a self, on_cpu: &'a CpuLight, sh_degree: usize) -> &'a LightTables {
        match on_cpu.tables.lights.is_empty() {
            true => &on_cpu.tables,
            false => self.whole.get_or_init(|| rendering_tables(&self.source.environment, sh_degree)),
        }
    }
}

/// A model prepared for rendering; may be shared between threads.
pub struct Renderer {
    pub(super) frames: FrameRenderer,
}

impl Renderer {
    /// A renderer of a checked model on the CPU engine.
    pub fn new(model: Arc<Model>) -> Self {
        Self { frames: FrameRenderer::on_cpu_only(model) }
    }

    /// A renderer of a checked model on `device`.
    ///
    /// # Errors
    /// If the device cannot hold the model.
    pub fn on(model: Arc<Model>, device: &Device) -> Result<Self, DeviceError> {
        Ok(Self { frames: device.frames(model)? })
    }

    /// The model.
    pub fn model(&self) -> &Model {
        self.frames.model()
    }

    /// Prepares a light for this model, including light that bounces between its surfaces: an environment map, or
    /// [`Model::recovered_light`].
    ///
    /// # Errors
    /// If the device failed.
    pub fn prepare_light(&self, light: impl Into<Illumination>) -> Result<PreparedLight, DeviceError> {
        let source = light.into();
        let frame = self.frames.prepare_light(&source)?;
        Ok(PreparedLight {
            source: source.with_at_most_rows(SAMPLED_ROWS),
            frame,
            split: OnceLock::new(),
            sampler: OnceLock::new(),
            whole: OnceLock::new(),
        })
    }

    /// The occluders of the model, for rays of the ray-traced tiers.
    pub fn occluders(&self) -> &OccluderBvh {
        self.frames.on_cpu().occluders()
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

    pub(super) fn light_on_cpu<'a>(&self, light: &'a PreparedLight) -> &'a CpuLight {
        self.frames.light_on_cpu(&light.frame, &light.source)
    }

    /// `camera` in the form that the engines use.
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
