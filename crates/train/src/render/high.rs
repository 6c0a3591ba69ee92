//! The high tier: strong small lights are taken out of the environment and cast a shadow each, asked for in every pixel;
//! the rest is standard.

use rayon::prelude::*;

use crate::render::Frame;
use crate::render::cpu_frame_job::CpuFrameJob;
use crate::render::direct::{PixelShadows, UnshadowedLight};
use relume_engine::RayLight;
use relume_engine::cpu::{OccluderBvh, Pass, SurfaceShader, blended_radiance, resolve};
use relume_layout::channel::{Channels, OutgoingRadiance};
use relume_layout::constants::EarlyStop;
use relume_scene::light::{DominantLight, LightTables, SplitEnvironment, rendering_tables};
use relume_scene::{EnvMap, Field, ShadeAt, VisibilityForm};

/// Most lights that get a shadow of their own.
const MAX_HIGH_TIER_LIGHTS: usize = 8;

/// An environment split for visibility fields of one degree.
pub(super) struct HighTierLight {
    lights: Vec<DominantLight>,
    /// Tables of the rest; none where nothing was taken out.
    rest: Option<LightTables>,
}

impl HighTierLight {
    /// Splits `environment`.
    pub(super) fn new(environment: &EnvMap, sh_degree: usize) -> Self {
        let split = SplitEnvironment::new(environment, MAX_HIGH_TIER_LIGHTS);
        let rest = (!split.lights.is_empty()).then(|| rendering_tables(&split.rest, sh_degree));
        Self { lights: split.lights, rest }
    }
}

impl HighTierLight {
    /// The lights with the rest, where there are any.
    pub(super) fn rays(&self) -> Option<RayLight<'_>> {
        Some(RayLight::Sharp { lights: &self.lights, rest: self.rest.as_ref()? })
    }
}

/// Renders every pixel under the rest and each of the lights; the job's shader has the tables of both together.
pub(super) fn render(job: &CpuFrameJob<'_>, light: &HighTierLight, occluders: &OccluderBvh) -> Frame {
    let shader = SurfaceShader { tables: light.rest.as_ref().unwrap_or(job.shader.tables), ..job.shader };
    let channels = Channels::Full(job.source.gaussians.width(Field::Visibility));
    let source = job.source.under(shader);
    let pass = Pass::forward(&source, job.frame.view, channels, EarlyStop::WhenSaturated);
    let direct = direct(job, light, &pass, occluders);
    resolve(&pass, &shader, job.frame.outputs, job.frame.depth_scale, |(x, y), surface| {
        let mut sent = match shader.options.shade_at {
            ShadeAt::Gaussian => blended_radiance(&pass, (x, y)),
            ShadeAt::Pixel => shader.shade(surface).outgoing(),
        };
        sent.add(direct[y * job.frame.view.width + x], 1.0);
        sent
    })
}

/// What each pixel, in rows, sends of the lights.
fn direct(
    job: &CpuFrameJob<'_>,
    light: &HighTierLight,
    pass: &Pass,
    occluders: &OccluderBvh,
) -> Vec<OutgoingRadiance> {
    let view = job.frame.view;
    let is_occluded = job.source.options.visibility != VisibilityForm::Off;
    let mut sum = vec![OutgoingRadiance::default(); view.width * view.height];
    for light in &light.lights {
        let unhidden = UnshadowedLight::new(&job.source, pass, light);
        let shadows = is_occluded.then(|| PixelShadows::new(pass, occluders, light));
        sum.par_iter_mut().enumerate().with_min_len(64).for_each(|(i, sum)| {
            let at = (i % view.width, i / view.width);
            let Some(sent) = unhidden.at(at) else { return };
            let share = shadows.as_ref().map_or(1.0, |shadows| shadows.share(at));
            sum.add(sent, share);
        });
    }
    sum
}
