//! The high tier: strong small lights are taken out of the environment and cast a shadow each; the rest is standard.
//!
//! A light's shadow is one probe a Gaussian in its exact direction. Models that are shaded at their Gaussians add the
//! light there; for others the shadow is blended, as a channel of its own behind the visibility coefficients.

use rayon::prelude::*;

use crate::engine::channel::{self, Channels, OutgoingRadiance};
use crate::engine::constants::EarlyStop;
use crate::engine::cpu::{
    AttributeSource, MAX_COEFFICIENTS, Pass, Surface, SurfaceShader, attribute_rows, blended_radiance,
    light_transmittance, normalise, project_all, reflector, resolve,
};
use crate::engine::{ProbeSettings, RasterCamera};
use crate::light::{DominantLight, LightTables, Sheen, SplitEnvironment, TableLight, rendering_tables};
use crate::render::Frame;
use crate::render::job::Job;
use crate::scene::{self, EnvMap, Field, ShadeAt};

/// Most lights that get a shadow of their own.
const MOST_LIGHTS: usize = 8;

/// An environment split for one model.
pub(super) struct SplitLight {
    lights: Vec<DominantLight>,
    /// Tables of the rest; none where nothing was taken out.
    rest: Option<LightTables>,
    /// `[light][Gaussian]`: share of the light that arrives.
    arriving: Vec<Vec<f32>>,
}

impl SplitLight {
    /// Splits `environment` and asks from every Gaussian of `source` towards every light.
    pub(super) fn new(source: &AttributeSource<'_>, environment: &EnvMap) -> Self {
        // Where Gaussians are shaded, no light needs a channel.
        let room = match source.options.shade_at {
            ShadeAt::Gaussian => MOST_LIGHTS,
            ShadeAt::Pixel => MAX_COEFFICIENTS.saturating_sub(source.gaussians.width(Field::Visibility)),
        };
        let split = SplitEnvironment::new(environment, MOST_LIGHTS.min(room));
        let lights: Vec<_> =
            split.lights.iter().map(|l| scene::SplitLight::from(&TableLight::from(l))).collect();
        let arriving = light_transmittance(source, &lights, ProbeSettings::of(source.options));
        let order = source.gaussians.visibility_order();
        let rest = (!split.lights.is_empty()).then(|| rendering_tables(&split.rest, order));
        Self { lights: split.lights, rest, arriving }
    }

    /// Share of each light that arrives at Gaussian `i`.
    fn arriving_at(&self, i: usize) -> impl Iterator<Item = f32> {
        self.arriving.iter().map(move |of| of.get(i).copied().unwrap_or(1.0))
    }
}

/// Renders every pixel under the rest and each of the lights; the job's shader has the tables of both together.
pub(super) fn render(job: &Job<'_>, light: &SplitLight) -> Frame {
    let shader = SurfaceShader { tables: light.rest.as_ref().unwrap_or(job.shader.tables), ..job.shader };
    match shader.options.shade_at {
        ShadeAt::Gaussian => at_gaussians(job, &shader, light),
        ShadeAt::Pixel => in_pixels(job, &shader, light),
    }
}

/// The lights are added to what each Gaussian sends.
fn at_gaussians(job: &Job<'_>, shader: &SurfaceShader<'_>, light: &SplitLight) -> Frame {
    let source = job.source.under(*shader);
    let full = Channels::Full(source.gaussians.width(Field::Visibility));
    let view = job.frame.view;
    let (splats, stored) = (project_all(&source, &view), full.stored());
    let mut rows = attribute_rows(&source, &view, &splats, full, stored);
    rows.par_chunks_mut(stored).zip(&splats).with_min_len(64).for_each(|(row, splat)| {
        let i = splat.gaussian as usize;
        let mean: [f32; 3] = source.gaussians.get(Field::Mean, i);
        let surface = source.surface(i, row, std::array::from_fn(|k| mean[k] - view.centre[k]));
        let mut direct = OutgoingRadiance { diffuse: [0.0; 3], specular: [0.0; 3] };
        add_lights(&light.lights, light.arriving_at(i), &surface, &mut direct);
        let gain = Sheen::new(surface.sheen, cosine(surface.normal, surface.view)).gain;
        for c in 0..3 {
            direct.diffuse[c] *= gain;
            row[OutgoingRadiance::TOTAL.start + c] += direct.diffuse[c] + direct.specular[c];
            row[OutgoingRadiance::SPECULAR.start + c] += direct.specular[c];
        }
    });
    let pass = Pass::blend(view, splats, full, source.row_light(), rows, EarlyStop::WhenSaturated);
    resolve(&pass, shader, job.frame.outputs, job.frame.depth_scale, |at, _| blended_radiance(&pass, at))
}

/// `|n . v|` of a normal of any length.
fn cosine(normal: [f32; 3], view: [f32; 3]) -> f32 {
    let (unit, _) = normalise(normal);
    (0..3).map(|k| unit[k] * view[k]).sum::<f32>().abs().min(1.0)
}

/// The lights are added to what each pixel sends; their shadows are blended.
fn in_pixels(job: &Job<'_>, shader: &SurfaceShader<'_>, light: &SplitLight) -> Frame {
    let coefficients = job.source.gaussians.width(Field::Visibility);
    let pass = pass(&job.source, job.frame.view, light, coefficients);
    resolve(&pass, shader, job.frame.outputs, job.frame.depth_scale, |_, surface| {
        let mut direct = shader.shade(surface).outgoing();
        let arriving = &surface.visibility[coefficients..coefficients + light.lights.len()];
        add_lights(&light.lights, arriving.iter().copied(), surface, &mut direct);
        direct
    })
}

/// The standard G-buffer with a channel a light behind the coefficients; tables have zeros there, so that shading
/// from tables does not see them.
fn pass(source: &AttributeSource<'_>, view: RasterCamera, light: &SplitLight, coefficients: usize) -> Pass {
    let (own, all) = (Channels::Full(coefficients), Channels::Full(coefficients + light.lights.len()));
    let splats = project_all(source, &view);
    let stored = all.stored();
    let mut rows = attribute_rows(source, &view, &splats, own, stored);
    rows.par_chunks_mut(stored).zip(&splats).with_min_len(64).for_each(|(row, splat)| {
        let extra = &mut row[channel::VISIBILITY + coefficients..];
        extra.iter_mut().zip(light.arriving_at(splat.gaussian as usize)).for_each(|(o, share)| *o = share);
    });
    Pass::blend(view, splats, all, source.row_light(), rows, EarlyStop::WhenSaturated)
}

fn add_lights(
    lights: &[DominantLight],
    arriving: impl Iterator<Item = f32>,
    surface: &Surface,
    direct: &mut OutgoingRadiance,
) {
    let reflector = reflector(surface);
    for (light, share) in lights.iter().zip(arriving) {
        let Some(reflected) = reflector.reflect(light.direction, light.radius) else { continue };
        let share = f64::from(share.clamp(0.0, 1.0));
        for c in 0..3 {
            let light = share * light.irradiance[c];
            direct.diffuse[c] += (light * reflected.diffuse[c]) as f32;
            direct.specular[c] += (light * reflected.specular[c]) as f32;
        }
    }
}
