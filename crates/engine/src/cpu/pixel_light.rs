//! Direct light of one small light per pixel: the reflected radiance without occlusion, and the share of the light that arrives.

use rayon::prelude::*;

use crate::cpu::{
    AttributeSource, OccluderBvh, Pass, Surface, attribute_rows, blended_radiance, normalise, reflector,
    surface_at, surface_points,
};
use crate::towards_light;
use relume_layout::channel::{COVERAGE, Channels, OutgoingRadiance, RowLight};
use relume_layout::constants::{EarlyStop, MIN_COVERAGE, SHADOW_SAMPLE_OFFSETS};
use relume_scene::light::{DominantLight, Sheen, TableLight};
use relume_scene::{Field, ShadeAt, ShadingOptions, SplitLight};

/// The reflected radiance of one unoccluded light in every pixel.
pub(super) enum UnshadowedLight<'a> {
    /// Reflected at the Gaussians, then blended.
    AtGaussians(Box<Pass>),
    /// Reflected at the surface of each pixel.
    InPixels(&'a Pass, &'a DominantLight, &'a ShadingOptions),
}

impl<'a> UnshadowedLight<'a> {
    /// Uses the shading location of the model of `source`. `pass` has the G-buffer.
    pub(super) fn new(source: &AttributeSource<'a>, pass: &'a Pass, light: &'a DominantLight) -> Self {
        match source.options.shade_at {
            ShadeAt::Gaussian => Self::AtGaussians(Box::new(blend_reflected(source, pass, light))),
            ShadeAt::Pixel => Self::InPixels(pass, light, source.options),
        }
    }

    /// Radiance of pixel (`x`, `y`); `None` without coverage, or if the light is behind the surface.
    pub(super) fn at(&self, (x, y): (usize, usize)) -> Option<OutgoingRadiance> {
        let pass: &Pass = match self {
            Self::AtGaussians(pass) => pass,
            Self::InPixels(pass, ..) => pass,
        };
        if !(pass.at(x, y, COVERAGE) >= MIN_COVERAGE) {
            return None;
        }
        let sent = match self {
            Self::AtGaussians(pass) => blended_radiance(pass, (x, y)),
            Self::InPixels(pass, light, options) => reflect(&surface_at(pass, x, y)?.0, light, options),
        };
        sent.total().iter().any(|v| *v > 0.0).then_some(sent)
    }
}

/// A pass that blends only the radiance that each Gaussian reflects.
fn blend_reflected(source: &AttributeSource<'_>, pass: &Pass, light: &DominantLight) -> Pass {
    let channels = Channels::Full(0);
    let (view, stored) = (pass.view, channels.stored());
    let splats = &pass.splats;
    let mut rows = attribute_rows(source, &view, splats, channels, stored);
    rows.par_chunks_mut(stored).zip(splats).with_min_len(64).for_each(|(row, splat)| {
        let i = splat.gaussian as usize;
        let mean: [f32; 3] = source.gaussians.get(Field::Mean, i);
        let surface = source.surface(i, row, std::array::from_fn(|k| mean[k] - view.centre[k]));
        let sent = reflect(&surface, light, source.options);
        row[OutgoingRadiance::TOTAL].copy_from_slice(&sent.total());
        row[OutgoingRadiance::SPECULAR].copy_from_slice(&sent.specular);
    });
    let binned = (splats.clone(), pass.tiles.clone());
    Pass::blend(view, binned, channels, RowLight::Outgoing, rows, EarlyStop::WhenSaturated)
}

/// The radiance that `surface` reflects of an unoccluded light, including sheen.
fn reflect(surface: &Surface, light: &DominantLight, options: &ShadingOptions) -> OutgoingRadiance {
    let Some(reflected) = reflector(surface, options).reflect(light.direction, light.radius) else {
        return OutgoingRadiance::default();
    };
    let (normal, _) = normalise(surface.normal);
    let nov = (0..3).map(|k| normal[k] * surface.view[k]).sum::<f32>().abs().min(1.0);
    let gain = f64::from(Sheen::new(surface.sheen, nov).gain);
    OutgoingRadiance {
        diffuse: std::array::from_fn(|c| (light.irradiance[c] * reflected.diffuse[c] * gain) as f32),
        specular: std::array::from_fn(|c| (light.irradiance[c] * reflected.specular[c]) as f32),
    }
}

/// Computes the share of one light that arrives at the surface of a pixel.
pub(super) struct PixelShadows<'a> {
    pass: &'a Pass,
    occluders: &'a OccluderBvh,
    directions: Vec<[f32; 3]>,
}

impl<'a> PixelShadows<'a> {
    /// Shadows that the Gaussians of `occluders` cast under `light` on the surfaces in `pass`.
    pub(super) fn new(pass: &'a Pass, occluders: &'a OccluderBvh, light: &DominantLight) -> Self {
        let directions = towards_light(&SplitLight::from(&TableLight::from(light)));
        Self { pass, occluders, directions }
    }

    /// Share of the light in pixel (`x`, `y`), 0 to 1: the mean over rays from points within the pixel to points of the light.
    pub(super) fn share(&self, (x, y): (usize, usize)) -> f32 {
        let points = surface_points(self.pass, (x, y), SHADOW_SAMPLE_OFFSETS);
        let rays = self.directions.len().max(points.len());
        let ray = |i: usize| {
            let (point, direction) = (points[i % points.len()], self.directions[i % self.directions.len()]);
            self.occluders.transmittance(point, direction)
        };
        (0..rays).map(ray).sum::<f32>() / rays as f32
    }
}
