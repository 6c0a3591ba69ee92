//! Frames of the CPU engine: a model prepared for rendering, and frames from light tables or along rays.

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

use rayon::prelude::*;

use crate::cpu::monte_carlo::{self, Sampling};
use crate::cpu::project::Splat;
use crate::cpu::resolve::resolve;
use crate::cpu::sharp_lights;
use crate::cpu::tiles::TileLists;
use crate::cpu::{
    AttributeSource, OccluderBvh, Pass, Probes, SurfaceShader, Transport, arriving, attribute_rows,
    outward_normals, project_all,
};
use crate::{BOUNCES, ColourMode, FrameJob, NO_INDIRECT_BASIS, PROBE_DIRECTIONS};
use crate::{Frame, ProbeSettings, RasterCamera, RayLight, fibonacci_sphere, indirect_basis};
use relume_layout::channel::{self, Channels, OutgoingRadiance, RowLight};
use relume_layout::constants::EarlyStop;
use relume_scene::Output;
use relume_scene::light::LightTables;
use relume_scene::{Field, IndirectForm, MAX_LIGHTS, Model, ShadeAt, SplitLight};

/// A model prepared for rendering. Data that does not depend on the light is computed on first use.
pub struct CpuFrameRenderer {
    model: Arc<Model>,
    transport: OnceLock<Transport>,
    occluders: OnceLock<OccluderBvh>,
}

/// A light prepared for the CPU engine.
pub struct CpuFrameLight {
    /// Tables of the light.
    pub tables: LightTables,
    /// Irradiance and mean blocked radiance from the model's other surfaces, per Gaussian.
    gathered: Vec<[f32; 6]>,
    /// Share of each dominant light that arrives, per Gaussian.
    arriving: Vec<[f32; MAX_LIGHTS]>,
    indirect_basis: [[f32; 3]; 16],
}

impl CpuFrameRenderer {
    /// Prepares a checked model.
    pub fn new(model: Arc<Model>) -> Self {
        Self { model, transport: OnceLock::new(), occluders: OnceLock::new() }
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// The light of `tables`, with the light that the model's surfaces send each other under it.
    pub fn prepare_light(&self, tables: LightTables) -> CpuFrameLight {
        let lights: Vec<SplitLight> = tables.lights.iter().map(SplitLight::from).collect();
        let arriving = arriving(&self.source(&[], &[], &NO_INDIRECT_BASIS), &lights);
        let source = self.source(&[], &arriving, &NO_INDIRECT_BASIS);
        let mut gathered = Vec::new();
        if source.options.indirect == IndirectForm::Gathered {
            let transport = self.transport.get_or_init(|| {
                let directions = fibonacci_sphere(PROBE_DIRECTIONS);
                let probes = Probes::measure(&source, directions, ProbeSettings::of(source.options));
                Transport::new(&probes, outward_normals(&source))
            });
            gathered = transport.gather(&source, &tables, BOUNCES);
        }
        let indirect_basis = indirect_basis(&tables);
        CpuFrameLight { tables, gathered, arriving, indirect_basis }
    }

    /// The model under `light`, not yet shaded.
    pub fn lit_source<'a>(&'a self, light: &'a CpuFrameLight) -> AttributeSource<'a> {
        self.source(&light.gathered, &light.arriving, &light.indirect_basis)
    }

    /// The shader of the model under `tables`.
    pub fn shader<'a>(&'a self, tables: &'a LightTables) -> SurfaceShader<'a> {
        let sh_degree = self.model.gaussians.visibility_degree();
        SurfaceShader { tables, options: &self.model.shading, sh_degree }
    }

    /// The occluder tree of the model.
    pub fn occluders(&self) -> &OccluderBvh {
        self.occluders.get_or_init(|| {
            let source = self.source(&[], &[], &NO_INDIRECT_BASIS);
            OccluderBvh::new(&source, ProbeSettings::of(source.options))
        })
    }

    /// Renders `job` from the light's tables.
    pub fn render(&self, job: &FrameJob<'_>, light: &CpuFrameLight) -> Frame {
        let (source, shader) = (self.lit_source(light), self.shader(&light.tables));
        match job.colour {
            ColourMode::Alone => colour(&source, job.view, &shader),
            ColourMode::WithGBuffer => standard(&source, job, &shader),
        }
    }

    /// Renders `job` with light that is traced along rays. `rays` must belong to the environment from which `light` was
    /// prepared.
    pub fn render_by_rays(&self, job: &FrameJob<'_>, light: &CpuFrameLight, rays: &RayLight<'_>) -> Frame {
        let source = self.lit_source(light);
        match *rays {
            RayLight::Sharp { lights, rest } => {
                sharp_lights::render(job, (&source, &self.shader(rest)), lights, self.occluders())
            }
            RayLight::Sampled { environment, samples, seed, pixels_before } => {
                let sampling = Sampling { samples, seed, pixels_before };
                let lit = (&source, &self.shader(&light.tables));
                monte_carlo::render(job, lit, environment, sampling, self.occluders())
            }
        }
    }

    fn source<'a>(
        &'a self,
        gathered: &'a [[f32; 6]],
        arriving: &'a [[f32; MAX_LIGHTS]],
        basis: &'a [[f32; 3]; 16],
    ) -> AttributeSource<'a> {
        AttributeSource {
            gaussians: &self.model.gaussians,
            prototypes: &self.model.prototypes,
            options: &self.model.shading,
            gathered,
            arriving,
            indirect_basis: basis,
            light: None,
        }
    }
}

/// `rgb` and `alpha` of Gaussians that are shaded once and blended in three channels.
fn colour(source: &AttributeSource<'_>, view: RasterCamera, shader: &SurfaceShader<'_>) -> Frame {
    let source = &source.shaded(*shader);
    let splats = project_all(source, &view);
    let tiles = TileLists::new(view.width, view.height, &splats);
    let stop = EarlyStop::WhenSaturated;
    // In a band of a frame most splats reach no tile.
    let shown: Vec<usize> = (0..splats.len()).filter(|i| !tiles.slots_of_splat(*i).is_empty()).collect();
    let shaded: Vec<Splat> = shown.iter().map(|i| splats[*i]).collect();
    let material = Channels::Material.stored();
    let rows = attribute_rows(source, &view, &shaded, Channels::Material, material);
    let stored = Channels::Colour.stored();
    let mut attributes = vec![0.0f32; splats.len() * stored];
    for (i, row) in shown.iter().zip(rows.chunks_exact(material)) {
        let out = &mut attributes[i * stored..];
        out[channel::COVERAGE] = row[channel::COVERAGE];
        out[channel::RADIANCE].copy_from_slice(&row[OutgoingRadiance::TOTAL]);
    }
    let pass = Pass::blend(view, (splats, tiles), Channels::Colour, RowLight::Outgoing, attributes, stop);
    let pixels = view.width * view.height;
    let (mut rgb, mut alpha) = (vec![[0.0f32; 3]; pixels], vec![0.0f32; pixels]);
    let rows = rgb.par_chunks_mut(view.width.max(1)).zip(alpha.par_chunks_mut(view.width.max(1)));
    rows.enumerate().for_each(|(y, (rgb, alpha))| {
        for (x, (rgb, alpha)) in rgb.iter_mut().zip(alpha).enumerate() {
            *rgb = std::array::from_fn(|c| pass.at(x, y, channel::RADIANCE.start + c));
            *alpha = pass.at(x, y, channel::COVERAGE);
        }
    });
    let planes = BTreeMap::from([(Output::Rgb, rgb.into_flattened()), (Output::Alpha, alpha)]);
    Frame { width: view.width as u32, height: view.height as u32, planes }
}

/// Every output of `job`, shaded where the model's options place the shading.
fn standard(source: &AttributeSource<'_>, job: &FrameJob<'_>, shader: &SurfaceShader<'_>) -> Frame {
    let coefficients = source.gaussians.width(Field::Visibility);
    let channels = Channels::Full(coefficients);
    let pass = Pass::forward(&source.under(*shader), job.view, channels, EarlyStop::WhenSaturated);
    resolve(&pass, shader, job.outputs, job.depth_scale, |at, surface| match shader.options.shade_at {
        ShadeAt::Pixel => shader.shade(surface).outgoing(),
        ShadeAt::Gaussian => blended_radiance(&pass, at),
    })
}

/// Radiance in pixel (`x`, `y`), whose coverage is above 0, of a pass whose Gaussians were shaded before blending.
pub fn blended_radiance(pass: &Pass, (x, y): (usize, usize)) -> OutgoingRadiance {
    let inverse = 1.0 / pass.at(x, y, channel::COVERAGE);
    let at = |first: usize, c: usize| pass.at(x, y, first + c) * inverse;
    let specular = std::array::from_fn(|c| at(OutgoingRadiance::SPECULAR.start, c));
    let diffuse = std::array::from_fn(|c| at(OutgoingRadiance::TOTAL.start, c) - specular[c]);
    OutgoingRadiance { diffuse, specular }
}
