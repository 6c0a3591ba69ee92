//! Frames of the CPU engine, from light tables or along rays.

use std::collections::BTreeMap;
use std::sync::Arc;

use rayon::prelude::*;

use crate::cpu::project::Splat;
use crate::cpu::resolve::resolve;
use crate::cpu::tiles::TileLists;
use crate::cpu::{
    AttributeSource, HostLight, HostModel, Pass, SurfaceShader, attribute_rows, monte_carlo, project_all,
    sharp_lights,
};
use crate::{ColourMode, DeviceError, Frame, FrameJob, FrameLight, FrameRenderer, RasterCamera, RayLight};
use relume_layout::channel::{self, Channels, OutgoingRadiance, RowLight};
use relume_layout::constants::EarlyStop;
use relume_scene::{Field, Illumination, Model, Output, ShadeAt};

/// The frames of a model on the CPU engine.
pub(crate) struct CpuFrameRenderer {
    host: Arc<HostModel>,
}

impl CpuFrameRenderer {
    /// Prepares a checked model.
    pub fn new(model: Arc<Model>) -> Self {
        Self { host: Arc::new(HostModel::new(model)) }
    }
}

impl FrameRenderer for CpuFrameRenderer {
    fn host(&self) -> &Arc<HostModel> {
        &self.host
    }

    fn is_gpu(&self) -> bool {
        false
    }

    fn max_rows(&self, _: usize, _: ColourMode) -> usize {
        usize::MAX
    }

    fn prepare_light(self: Arc<Self>, light: &Illumination) -> Result<Box<dyn FrameLight>, DeviceError> {
        Ok(Box::new(self.host.prepare_light(self.host.light_tables(light))))
    }
}

impl FrameLight for HostLight {
    fn render(&self, job: &FrameJob<'_>) -> Result<Frame, DeviceError> {
        let (source, shader) = (self.source(), self.shader(&self.tables));
        Ok(match job.colour {
            ColourMode::Alone => colour(&source, job.view, &shader),
            ColourMode::WithGBuffer => standard(&source, job, &shader),
        })
    }

    fn render_by_rays(&self, job: &FrameJob<'_>, rays: &RayLight<'_>) -> Result<Frame, DeviceError> {
        let occluders = self.model.occluders();
        Ok(match *rays {
            RayLight::Sharp { lights, rest } => {
                let source = self.source_without_sharp_lights(rest);
                sharp_lights::render(job, (&source, &self.shader(rest)), lights, occluders)
            }
            RayLight::Sampled { environment, samples, seed, pixels_before } => {
                let source = self.source_without_sky_shadows();
                let lit = (&source, &self.shader(&self.tables));
                monte_carlo::render(job, lit, (environment, samples), (seed, pixels_before), occluders)
            }
        })
    }

    fn on_host(&self) -> Option<&HostLight> {
        Some(self)
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
