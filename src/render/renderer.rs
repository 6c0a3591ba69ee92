//! The renderer a service keeps per model.

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::engine::Device;
use crate::engine::channel::{self, Channels};
use crate::engine::cpu::{
    AttributeSource, LEAST_COVERAGE, Pass, ProbeSettings, Probes, Shader, Surface, Transport, View,
    fibonacci_sphere, normalise, outward_normals, surface_at,
};
use crate::engine::gpu::GpuError;
use crate::light::{LightTables, rendering_tables};
use crate::render::on_gpu::{LightOnGpu, OnGpu};
use crate::render::{Frame, Output, preview};
use crate::scene::{Camera, EnvMap, Field, IndirectForm, Model};

/// Most pixels of a frame.
const MOST_PIXELS: u64 = 64 << 20;
/// Probe directions behind the gathered light of a render.
pub(super) const PROBE_DIRECTIONS: usize = 96;
/// Rounds of gathered light.
pub(super) const BOUNCES: usize = 3;

/// A named trade of time against accuracy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Default)]
#[serde(rename_all = "snake_case")]
pub enum Tier {
    /// Shade each Gaussian once, blend three channels.
    Preview,
    /// Deferred split-sum with directional diffuse.
    #[default]
    Standard,
}

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

/// An environment turned into the tables a model is shaded with; costs a second at most, keep it. Belongs to the renderer
/// that prepared it.
pub struct PreparedLight(pub(super) Prepared);

pub(super) enum Prepared {
    Cpu(Box<CpuLight>),
    Gpu(LightOnGpu),
}

pub(super) struct CpuLight {
    pub(super) tables: LightTables,
    pub(super) gathered: Vec<[f32; 6]>,
    pub(super) indirect_basis: [[f32; 3]; 16],
}

/// Where the frames are made.
pub(super) enum Engine {
    /// With what hides what, once it was needed: it does not depend on the light.
    Cpu(OnceLock<Transport>),
    Gpu(Box<OnGpu>),
}

/// A model ready to be rendered many times. Shared between threads.
pub struct Renderer {
    model: Arc<Model>,
    pub(super) engine: Engine,
}

impl Renderer {
    /// Takes a checked model in, to be rendered on the CPU engine.
    pub fn new(model: Arc<Model>) -> Self {
        Self { model, engine: Engine::Cpu(OnceLock::new()) }
    }

    /// Takes a checked model in, to be rendered on `device`.
    ///
    /// # Errors
    /// When the device cannot hold the model.
    pub fn on(model: Arc<Model>, device: &Device) -> Result<Self, GpuError> {
        match device {
            Device::Cpu => Ok(Self::new(model)),
            Device::Gpu(gpu) => {
                let engine = Engine::Gpu(Box::new(OnGpu::new(gpu, &model)?));
                Ok(Self { model, engine })
            }
        }
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
        }
    }

    /// Tables for relighting this model under `environment`, light that bounces between its surfaces included.
    ///
    /// # Errors
    /// When the device failed.
    pub fn prepare_light(&self, environment: &EnvMap) -> Result<PreparedLight, GpuError> {
        let tables = rendering_tables(environment, self.model.gaussians.visibility_order());
        Ok(PreparedLight(match &self.engine {
            Engine::Cpu(transport) => Prepared::Cpu(Box::new(self.light_on_cpu(transport, tables))),
            Engine::Gpu(engine) => Prepared::Gpu(engine.prepare_light(&self.model, &tables)?),
        }))
    }

    fn light_on_cpu(&self, transport: &OnceLock<Transport>, tables: LightTables) -> CpuLight {
        let mut gathered = Vec::new();
        if self.model.shading.indirect == IndirectForm::Gathered {
            let none = [[0.0; 3]; 16];
            let source = self.source(&[], &none);
            let transport = transport.get_or_init(|| {
                let probes = Probes::measure(
                    &source,
                    fibonacci_sphere(PROBE_DIRECTIONS),
                    ProbeSettings::of(source.options),
                );
                Transport::new(&probes, outward_normals(&source))
            });
            gathered = transport.gather(&source, &tables, BOUNCES);
        }
        let indirect_basis = crate::engine::cpu::indirect_basis(&tables);
        CpuLight { tables, gathered, indirect_basis }
    }

    /// A camera in capture coordinates, checked, in the model's normalised world.
    pub(super) fn camera_inside(&self, camera: &Camera) -> Result<Camera, RenderError> {
        let checked =
            camera.validated().map_err(|e| RenderError::Refused { field: e.field, reason: e.reason })?;
        if u64::from(checked.width) * u64::from(checked.height) > MOST_PIXELS {
            let reason = format!("more than {MOST_PIXELS} pixels");
            return Err(RenderError::Refused { field: "width,height", reason });
        }
        Ok(checked.in_normalised_world(self.model.world_scale, self.model.world_offset))
    }

    /// Renders `outputs` for a camera in capture coordinates.
    ///
    /// # Errors
    /// Names the camera field that cannot be rendered.
    pub fn render(
        &self,
        camera: &Camera,
        light: &PreparedLight,
        tier: Tier,
        outputs: &[Output],
    ) -> Result<Frame, RenderError> {
        let camera = self.camera_inside(camera)?;
        let view = View::new(&camera, &self.model.shading);
        let mut wanted: Vec<Output> = outputs.to_vec();
        wanted.push(Output::Alpha);
        wanted.sort_unstable();
        wanted.dedup();
        // The preview tier only has a colour; anything else needs the G-buffer anyway.
        let colour_only = wanted.iter().all(|o| matches!(o, Output::Rgb | Output::Alpha));
        let is_preview = tier == Tier::Preview && colour_only;
        let light = match (&self.engine, &light.0) {
            (Engine::Cpu(_), Prepared::Cpu(light)) => light,
            (Engine::Gpu(engine), Prepared::Gpu(light)) => {
                return Ok(engine.render(&self.model, &view, light, is_preview, &wanted)?);
            }
            _ => return Err(GpuError::Internal("a light that another renderer prepared".to_owned()).into()),
        };
        let source = self.source(&light.gathered, &light.indirect_basis);
        let order = self.model.gaussians.visibility_order();
        let shader = Shader { tables: &light.tables, options: &self.model.shading, order };
        if is_preview {
            return Ok(preview::render(&source, view, &shader));
        }
        let coefficients = self.model.gaussians.width(Field::Visibility);
        let pass = Pass::forward(&source, view, Channels::Full(coefficients), true);
        let depth_scale = (1.0 / self.model.world_scale) as f32;
        Ok(develop(&pass, &shader, &wanted, depth_scale))
    }
}

/// Turns a G-buffer into the planes asked for.
fn develop(pass: &Pass, shader: &Shader<'_>, outputs: &[Output], depth_scale: f32) -> Frame {
    let (w, h) = (pass.view.width, pass.view.height);
    let stride: usize = outputs.iter().map(|o| o.channels()).sum();
    let mut pixels = vec![0.0f32; w * h * stride];
    pixels.par_chunks_mut(w * stride).enumerate().for_each(|(y, row)| {
        for (x, out) in row.chunks_exact_mut(stride).enumerate() {
            write_pixel(pass, shader, outputs, depth_scale, (x, y), out);
        }
    });
    let mut planes = BTreeMap::new();
    let mut first = 0;
    for output in outputs {
        let n = output.channels();
        let plane = pixels.chunks_exact(stride).flat_map(|p| p[first..first + n].iter().copied()).collect();
        planes.insert(*output, plane);
        first += n;
    }
    Frame { width: w as u32, height: h as u32, planes }
}

fn write_pixel(
    pass: &Pass,
    shader: &Shader<'_>,
    outputs: &[Output],
    depth_scale: f32,
    (x, y): (usize, usize),
    out: &mut [f32],
) {
    let surface = surface_at(pass, x, y);
    let lit = outputs.iter().any(|o| matches!(o, Output::Rgb | Output::Diffuse | Output::Specular));
    let shaded = surface.as_ref().filter(|_| lit).map(|(s, coverage)| (shader.shade(s), *coverage));
    let mut first = 0;
    for output in outputs {
        let target = &mut out[first..first + output.channels()];
        first += output.channels();
        match output {
            Output::Alpha => target[0] = pass.at(x, y, channel::COVERAGE),
            Output::Depth if surface.is_none() => target[0] = f32::INFINITY,
            Output::Rgb | Output::Diffuse | Output::Specular => {
                let Some((s, coverage)) = &shaded else { continue };
                let part = |c: usize| match output {
                    Output::Diffuse => s.diffuse[c],
                    Output::Specular => s.specular[c],
                    _ => s.diffuse[c] + s.specular[c],
                };
                (0..3).for_each(|c| target[c] = part(c) * coverage);
            }
            _ => {
                if let Some((s, coverage)) = &surface {
                    write_attribute(pass, shader, *output, (s, *coverage), depth_scale, (x, y), target);
                }
            }
        }
    }
}

fn write_attribute(
    pass: &Pass,
    shader: &Shader<'_>,
    output: Output,
    (surface, coverage): (&Surface, f32),
    depth_scale: f32,
    (x, y): (usize, usize),
    target: &mut [f32],
) {
    let (unit, length) = normalise(surface.normal);
    let facing: f32 = (0..3).map(|k| unit[k] * surface.view[k]).sum();
    let normal = if facing < 0.0 { unit.map(|v| -v) } else { unit };
    match output {
        Output::Albedo => target.copy_from_slice(&surface.albedo),
        Output::Normal if length > LEAST_COVERAGE => target.copy_from_slice(&normal),
        Output::Metallic => target[0] = surface.metal,
        Output::Roughness => target[0] = surface.rough,
        Output::Visibility => {
            target[0] = shader.ambient_occlusion(&surface.visibility, normal).clamp(0.0, 1.0)
        }
        Output::Depth => target[0] = pass.at(x, y, channel::DEPTH) / coverage * depth_scale,
        Output::Radiance => {
            for (k, t) in target.iter_mut().enumerate() {
                let shown = (pass.at(x, y, channel::RADIANCE.start + k) / coverage).clamp(0.0, 1.0);
                *t = crate::engine::cpu::linear_from_srgb(shown) * coverage;
            }
        }
        _ => {}
    }
}
