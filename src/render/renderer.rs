//! The renderer a service keeps per model.

use std::sync::{Arc, OnceLock};

use crate::engine::Device;
use crate::engine::cpu::{AttributeSource, Occluders, Shader, Transport};
use crate::engine::gpu::GpuError;
use crate::engine::gpu::frames::{FrameContent, FrameLight, Frames, GatherSettings};
use crate::engine::{ProbeSettings, RasterCamera};
use crate::light::{EnvSampler, rendering_tables};
use crate::render::high::{self, SplitLight};
use crate::render::standard::{self, BOUNCES, LightOnCpu, PROBE_DIRECTIONS};
use crate::render::{Frame, Output, Quality, Tier, colour, reference};
use crate::scene::{Camera, EnvMap, Model, ShadeAt};

/// Most pixels of a frame.
const MOST_PIXELS: u64 = 64 << 20;
/// Why there is no frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RenderError {
    /// The request cannot be rendered.
    #[error("{field}: {reason}")]
    Refused {
        /// The request field at fault.
        field: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// The device failed.
    #[error(transparent)]
    Device(#[from] GpuError),
}

/// An environment turned into what a model is shaded with; costs a second at most, keep it. Belongs to the renderer
/// that prepared it. What only some tiers need is made when the first of them asks.
pub struct PreparedLight {
    environment: EnvMap,
    pub(super) on_gpu: Option<FrameLight>,
    pub(super) on_cpu: OnceLock<LightOnCpu>,
    split: OnceLock<SplitLight>,
    sampler: OnceLock<EnvSampler>,
}

/// A model ready to be rendered many times. Shared between threads.
pub struct Renderer {
    model: Arc<Model>,
    /// Where the two fast tiers run, if not on the CPU engine.
    gpu: Option<Box<Frames>>,
    /// What sends light to what, and what hides what: independent of the light, made when first needed.
    transport: OnceLock<Transport>,
    occluders: OnceLock<Occluders>,
}

/// A frame to make on the CPU engine.
pub(super) struct Job<'a> {
    pub(super) source: AttributeSource<'a>,
    pub(super) view: RasterCamera,
    pub(super) outputs: &'a [Output],
    /// From model to capture units.
    pub(super) depth_scale: f32,
}

const NO_BASIS: [[f32; 3]; 16] = [[0.0; 3]; 16];

impl Renderer {
    /// Takes a checked model in, to be rendered on the CPU engine.
    pub fn new(model: Arc<Model>) -> Self {
        Self { model, gpu: None, transport: OnceLock::new(), occluders: OnceLock::new() }
    }

    /// Takes a checked model in, to be rendered on `device`: tiers `preview` and `standard` there, `high` and
    /// `reference` on the CPU engine whatever the device.
    ///
    /// # Errors
    /// When the device cannot hold the model.
    pub fn on(model: Arc<Model>, device: &Device) -> Result<Self, GpuError> {
        let gpu = match device {
            Device::Cpu => None,
            Device::Gpu(gpu) => {
                let gather = GatherSettings { directions: PROBE_DIRECTIONS, bounces: BOUNCES };
                Some(Box::new(Frames::new(gpu, &model, gather)?))
            }
        };
        Ok(Self { gpu, ..Self::new(model) })
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    pub(super) fn source<'a>(
        &'a self,
        gathered: &'a [[f32; 6]],
        basis: &'a [[f32; 3]; 16],
    ) -> AttributeSource<'a> {
        AttributeSource {
            gaussians: &self.model.gaussians,
            prototypes: &self.model.prototypes,
            options: &self.model.shading,
            gathered,
            indirect_basis: basis,
            light: None,
        }
    }

    /// Makes `environment` ready for this model, light that bounces between its surfaces included.
    ///
    /// # Errors
    /// When the device failed.
    pub fn prepare_light(&self, environment: &EnvMap) -> Result<PreparedLight, GpuError> {
        let tables = rendering_tables(environment, self.model.gaussians.visibility_order());
        let mut light = PreparedLight {
            environment: at_most(environment, reference::MOST_ROWS),
            on_gpu: None,
            on_cpu: OnceLock::new(),
            split: OnceLock::new(),
            sampler: OnceLock::new(),
        };
        match &self.gpu {
            Some(gpu) => light.on_gpu = Some(gpu.prepare_light(&tables)?),
            None => {
                let on_cpu = LightOnCpu::new(&self.bare_source(), &self.transport, tables);
                light.on_cpu = OnceLock::from(on_cpu);
            }
        }
        Ok(light)
    }

    /// The model without gathered light.
    fn bare_source(&self) -> AttributeSource<'_> {
        self.source(&[], &NO_BASIS)
    }

    /// The light on the CPU engine, for the tiers that have no other.
    fn on_cpu<'a>(&self, light: &'a PreparedLight) -> &'a LightOnCpu {
        light.on_cpu.get_or_init(|| {
            let tables = rendering_tables(&light.environment, self.model.gaussians.visibility_order());
            LightOnCpu::new(&self.bare_source(), &self.transport, tables)
        })
    }

    /// What hides what, as the reference tier asks it.
    pub fn occluders(&self) -> &Occluders {
        self.occluders.get_or_init(|| {
            let source = self.bare_source();
            Occluders::new(&source, ProbeSettings::of(source.options))
        })
    }

    /// Renders `outputs` for a camera in capture coordinates, at a [`Tier`] or, with its samples and seed, a [`Quality`].
    ///
    /// # Errors
    /// Names the field (of the camera, or `samples`) that cannot be rendered.
    pub fn render(
        &self,
        camera: &Camera,
        light: &PreparedLight,
        quality: impl Into<Quality>,
        outputs: &[Output],
    ) -> Result<Frame, RenderError> {
        let quality = quality.into();
        quality.check()?;
        let view = self.view(camera)?;
        if light.on_gpu.is_some() != self.gpu.is_some() {
            return Err(GpuError::Misuse("a light that another renderer prepared".to_owned()).into());
        }
        let mut wanted: Vec<Output> = outputs.to_vec();
        wanted.push(Output::Alpha);
        wanted.sort_unstable();
        wanted.dedup();
        // Where Gaussians are shaded, colour alone needs no G-buffer; anything else does, in every tier.
        let is_lit = match quality.tier {
            Tier::Preview => true,
            Tier::Standard => self.model.shading.shade_at == ShadeAt::Gaussian,
            Tier::High | Tier::Reference => false,
        };
        let is_colour = is_lit && wanted.iter().all(|o| matches!(o, Output::Rgb | Output::Alpha));
        if let (Some(gpu), Some(on_gpu), Tier::Preview | Tier::Standard) =
            (&self.gpu, &light.on_gpu, quality.tier)
        {
            let content = if is_colour { FrameContent::Colour } else { FrameContent::GBuffer };
            return Ok(gpu.render(&view, on_gpu, content, &wanted)?);
        }
        let on_cpu = self.on_cpu(light);
        let source = self.source(&on_cpu.gathered, &on_cpu.indirect_basis);
        let order = self.model.gaussians.visibility_order();
        let shader = Shader { tables: &on_cpu.tables, options: &self.model.shading, order };
        let depth_scale = (1.0 / self.model.world_scale) as f32;
        let job = Job { source, view, outputs: &wanted, depth_scale };
        Ok(match quality.tier {
            Tier::Preview | Tier::Standard if is_colour => colour::render(&job.source, view, &shader),
            Tier::Preview | Tier::Standard => standard::render(&job, &shader),
            Tier::High => {
                let split = light.split.get_or_init(|| SplitLight::new(&job.source, &light.environment));
                high::render(&job, &shader, split)
            }
            Tier::Reference => {
                let sampler = light.sampler.get_or_init(|| EnvSampler::new(light.environment.clone()));
                reference::render(&job, &shader, sampler, self.occluders(), quality)
            }
        })
    }

    /// `camera` as the engines want it.
    pub(super) fn view(&self, camera: &Camera) -> Result<RasterCamera, RenderError> {
        let checked =
            camera.validated().map_err(|e| RenderError::Refused { field: e.field, reason: e.reason })?;
        if u64::from(checked.width) * u64::from(checked.height) > MOST_PIXELS {
            let reason = format!("more than {MOST_PIXELS} pixels");
            return Err(RenderError::Refused { field: "width,height", reason });
        }
        let camera = checked.in_normalised_world(self.model.world_scale, self.model.world_offset);
        Ok(RasterCamera::new(&camera, &self.model.shading))
    }
}

/// The map with no more than `rows` rows.
fn at_most(map: &EnvMap, rows: usize) -> EnvMap {
    match map.height() > rows {
        true => map.resampled((map.width() * rows / map.height()).max(1), rows),
        false => map.clone(),
    }
}
