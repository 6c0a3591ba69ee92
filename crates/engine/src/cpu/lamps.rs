//! Frames under lamps: lights at a place of the world, whose direction and distance differ from Gaussian to Gaussian (docs/MODEL.md,
//! section 4).

use glam::DVec3;
use rayon::prelude::*;

use crate::cpu::occluder::{Vec3, dot};
use crate::cpu::shown_splats::{ShadedColumns, ShownSplats};
use crate::cpu::{
    AttributeSource, HostModel, Pass, normalise, outward_normals, reflector, surface_at, surface_points,
};
use crate::{NO_INDIRECT_BASIS, RasterCamera, zeros};
use relume_layout::channel::Channels;
use relume_layout::constants::{EarlyStop, MIN_NOV, SHADOW_SAMPLE_OFFSETS};
use relume_scene::light::Sheen;
use relume_scene::{Field, VisibilityForm};

/// Channels of a frame under lamps: diffuse and specular radiance.
const CHANNELS: usize = 6;
/// Floats per splat, whole groups of channels.
const STORED: usize = 8;
/// Rays of one step.
const STEP_RAYS: usize = 1 << 19;
/// Splats of one parallel task.
const SPLATS_AT_ONCE: usize = 64;
/// Least distance of a lamp, normalised world: nearer surfaces receive as much light as at this distance.
pub(super) const MIN_DISTANCE: f32 = 0.01;

/// A lamp in the normalised world.
#[derive(Debug, Clone, PartialEq)]
pub struct Lamp {
    /// Points of its surface, at least one, each with the same share of the light.
    pub points: Vec<[f32; 3]>,
    /// Unit normal of a flat lamp, which emits like a Lambert surface, on this side alone. `None`: emits in all directions.
    pub normal: Option<[f32; 3]>,
    /// Cone to which the light is limited.
    pub cone: Option<LampCone>,
    /// Radiant intensity along the normal or axis: irradiance of a surface that faces the lamp, times the square of its distance.
    pub intensity: [f32; 3],
    /// Radius of a disc of the area of a point's share of the surface, which widens highlights.
    pub radius: f32,
}

/// A cone of light around an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LampCone {
    /// Unit direction in which the lamp shines.
    pub axis: [f32; 3],
    /// Cosine of the half angle at which the light ends.
    pub outer: f32,
    /// Cosine of the half angle up to which the light is full.
    pub inner: f32,
}

impl Lamp {
    /// Radiant intensity of the whole lamp in the unit direction `away`, as a share of that along its axis.
    pub(super) fn emission(&self, away: Vec3) -> f32 {
        let flat = self.normal.map_or(1.0, |normal| dot(normal, away).max(0.0));
        flat * self.cone.map_or(1.0, |cone| {
            let place = (dot(cone.axis, away) - cone.outer) / (cone.inner - cone.outer).max(1e-6);
            let place = place.clamp(0.0, 1.0);
            place * place * (3.0 - 2.0 * place)
        })
    }
}

/// Where the shadows of lamps are computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LampShadows {
    /// Once for each Gaussian: shadows are as sharp as the Gaussians.
    AtGaussians,
    /// In each pixel, by rays from the surface that it shows.
    InPixels,
}

/// A frame under lamps that is computed in steps of a fraction of a second.
pub struct LampFrame<'a> {
    shading: LampShading<'a>,
    lamps: Vec<Lamp>,
    splats: ShownSplats,
    /// The surfaces of the pixels, for shadows in pixels.
    pass: Option<Pass>,
    /// The lamp and the row that come next.
    lamp: usize,
    row: usize,
    /// The next lamp without shadows.
    parts: [Vec<f32>; 2],
    sums: [Vec<f32>; 2],
}

impl HostModel {
    /// The frame of `view` under `lamps` alone. Surfaces do not send the light on to each other. Models that are shaded in the pixel are
    /// shaded at their Gaussians.
    pub fn lamp_frame(&self, view: RasterCamera, lamps: Vec<Lamp>, shadows: LampShadows) -> LampFrame<'_> {
        let source = self.source(&[], &[], &NO_INDIRECT_BASIS);
        let splats = ShownSplats::new(&source, view);
        let has_pass = shadows == LampShadows::InPixels && source.options.visibility != VisibilityForm::Off;
        let channels = Channels::Full(source.gaussians.width(Field::Visibility));
        let pass = has_pass.then(|| Pass::forward(&source, view, channels, EarlyStop::WhenSaturated));
        let shading = LampShading { host: self, source, outward: outward_normals(&source), view };
        let sums = [0, 1].map(|_| zeros(3 * view.width * view.height));
        LampFrame { shading, lamps, splats, pass, lamp: 0, row: 0, parts: [Vec::new(), Vec::new()], sums }
    }
}

impl LampFrame<'_> {
    /// Computes a part. Returns false when all lamps are done.
    pub fn step(&mut self) -> bool {
        let Some(lamp) = self.lamps.get(self.lamp) else { return false };
        if self.row == 0 {
            self.parts = self.shading.planes(&self.splats, lamp, self.pass.is_none());
        }
        let RasterCamera { width, height, .. } = self.shading.view;
        let rows = match &self.pass {
            None => height,
            Some(_) => (STEP_RAYS / (width * lamp.points.len()).max(1)).max(1),
        };
        let pixels = self.row * width..(self.row + rows).min(height) * width;
        let share = |i: usize| match &self.pass {
            None => 1.0,
            Some(pass) => self.shading.share(pass, lamp, &self.parts, i),
        };
        let shares: Vec<f32> = pixels.clone().into_par_iter().with_min_len(256).map(share).collect();
        for (sum, part) in self.sums.iter_mut().zip(&self.parts) {
            let values = 3 * pixels.start..3 * pixels.end;
            let triples =
                sum[values.clone()].as_chunks_mut::<3>().0.iter_mut().zip(part[values].as_chunks::<3>().0);
            triples
                .zip(&shares)
                .for_each(|((sum, part), share)| (0..3).for_each(|c| sum[c] += share * part[c]));
        }
        self.row += rows;
        if self.row >= height {
            (self.row, self.lamp) = (0, self.lamp + 1);
        }
        self.lamp < self.lamps.len()
    }

    /// Diffuse and specular radiance of the steps so far, linear RGB, premultiplied, row-major.
    pub fn into_planes(self) -> [Vec<f32>; 2] {
        self.sums
    }
}

struct LampShading<'a> {
    host: &'a HostModel,
    source: AttributeSource<'a>,
    outward: Vec<Vec3>,
    view: RasterCamera,
}

impl LampShading<'_> {
    /// The frame under `lamp`: a plane of diffuse and one of specular RGB.
    fn planes(&self, splats: &ShownSplats, lamp: &Lamp, has_shadows: bool) -> [Vec<f32>; 2] {
        let mut attributes = zeros(splats.splats.len() * STORED);
        let rows = splats.rows_of_shown(&mut attributes, STORED);
        let shown = rows.into_par_iter().zip(&splats.shown);
        let shown = shown.zip(splats.materials.par_chunks(ShownSplats::MATERIAL));
        shown.with_min_len(SPLATS_AT_ONCE).for_each(|((row, splat), material)| {
            let i = splats.splats[*splat as usize].gaussian as usize;
            let [diffuse, specular] = self.radiance(i, material, lamp, has_shadows);
            row[..3].copy_from_slice(&diffuse);
            row[3..CHANNELS].copy_from_slice(&specular);
        });
        let shaded = ShadedColumns { channels: CHANNELS, stored: STORED, attributes };
        let strips: Vec<Vec<f32>> =
            (0..splats.strips()).into_par_iter().map(|index| splats.strip(&shaded, index)).collect();
        let mut out = [Vec::new(), Vec::new()];
        for strip in &strips {
            let pixels = strip.len() / CHANNELS;
            for (part, plane) in out.iter_mut().enumerate() {
                plane.extend((0..3 * pixels).map(|i| strip[(3 * part + i % 3) * pixels + i / 3]));
            }
        }
        out
    }

    /// Share of `lamp` that reaches the surface of row-major pixel `i`; 0 where `parts`, the frame without shadows, are dark.
    fn share(&self, pass: &Pass, lamp: &Lamp, parts: &[Vec<f32>; 2], i: usize) -> f32 {
        let is_lit = parts.iter().any(|part| part[3 * i..3 * i + 3].iter().any(|v| *v > 0.0));
        let (x, y) = (i % self.view.width, i / self.view.width);
        if !is_lit || surface_at(pass, x, y).is_none() {
            return 0.0;
        }
        let starts = surface_points(pass, (x, y), SHADOW_SAMPLE_OFFSETS);
        let rays = lamp.points.len().max(starts.len());
        let ray = |k: usize| {
            let start = starts[k % starts.len()];
            let (towards, distance) = direction(start, lamp.points[k % lamp.points.len()]);
            self.host.occluders().transmittance_up_to(start, towards, distance)
        };
        (0..rays).map(ray).sum::<f32>() / rays as f32
    }

    /// Diffuse and specular radiance of Gaussian `i` with attributes `material` towards the camera.
    fn radiance(&self, i: usize, material: &[f32], lamp: &Lamp, has_shadows: bool) -> [[f32; 3]; 2] {
        let mean: Vec3 = self.source.gaussians.get(Field::Mean, i);
        let surface =
            self.source.surface(i, material, std::array::from_fn(|k| mean[k] - self.view.centre[k]));
        let (normal, _) = normalise(surface.normal);
        let facing = dot(normal, surface.view);
        let normal = if facing < 0.0 { normal.map(|v| -v) } else { normal };
        let sheen = Sheen::new(surface.sheen, facing.abs().clamp(MIN_NOV, 1.0)).gain;
        let reflector = reflector(&surface, self.source.options);
        let start = self.start(i, mean);
        let mut sums = [[0.0f32; 3]; 2];
        let share = 1.0 / lamp.points.len().max(1) as f32;
        for point in &lamp.points {
            let (towards, distance) = direction(start, *point);
            let emission = lamp.emission(towards.map(|v| -v));
            if !(emission > 0.0 && dot(normal, towards) > 0.0) {
                continue;
            }
            let arriving = if has_shadows { self.transmittance(start, towards, distance) } else { 1.0 };
            let distance = distance.max(MIN_DISTANCE);
            let received = emission * arriving * share / (distance * distance);
            let d = DVec3::from_array(towards.map(f64::from));
            let Some(sent) = reflector.reflect(d, f64::from(lamp.radius / distance)) else { continue };
            for c in 0..3 {
                sums[0][c] += lamp.intensity[c] * received * sheen * sent.diffuse[c] as f32;
                sums[1][c] += lamp.intensity[c] * received * sent.specular[c] as f32;
            }
        }
        sums
    }

    /// The point of Gaussian `i` from which its visibility is measured, as for probes: one standard deviation outside its mean.
    fn start(&self, i: usize, mean: Vec3) -> Vec3 {
        let geometry = self.source.geometry(i);
        let q = crate::cpu::rotation(geometry.quaternion);
        let outward = self.outward[i];
        let square: f32 = (0..3)
            .map(|k| {
                let along: f32 = (0..3).map(|r| q[r][k] * outward[r]).sum();
                (along * geometry.log_scale[k].exp()).powi(2)
            })
            .sum();
        std::array::from_fn(|k| mean[k] + square.sqrt() * outward[k])
    }

    fn transmittance(&self, start: Vec3, towards: Vec3, distance: f32) -> f32 {
        match self.source.options.visibility {
            VisibilityForm::Off => 1.0,
            _ => self.host.occluders().transmittance_up_to(start, towards, distance),
        }
    }
}

/// Unit direction and distance from one point to another.
pub(super) fn direction(from: Vec3, to: Vec3) -> (Vec3, f32) {
    let offset: Vec3 = std::array::from_fn(|k| to[k] - from[k]);
    let distance = dot(offset, offset).sqrt();
    (offset.map(|v| v / distance.max(1e-9)), distance)
}

#[cfg(test)]
mod tests {
    use std::f32::consts::PI;
    use std::sync::Arc;

    use super::*;
    use relume_scene::{Camera, Gaussians, Model};

    /// A matte floor of discs at z = 0 that faces up, and a small screen above its middle at z = 0.3.
    fn model(has_screen: bool) -> HostModel {
        let side = 41usize;
        let count = side * side + 9 * usize::from(has_screen);
        let mut g = Gaussians::zeroed(count, 1, 2, 0);
        let at = |k: usize, spacing: f32, side: usize| (k as f32 - (side - 1) as f32 / 2.0) * spacing;
        for i in 0..count {
            let mean = match i.checked_sub(side * side) {
                None => [at(i % side, 0.05, side), at(i / side, 0.05, side), 0.0],
                Some(k) => [at(k % 3, 0.05, 3), at(k / 3, 0.05, 3), 0.3],
            };
            g.row_mut(Field::Mean, i).copy_from_slice(&mean);
            g.row_mut(Field::LogScale, i).copy_from_slice(&[0.04f32.ln(), 0.04f32.ln(), 1e-3f32.ln()]);
            g.row_mut(Field::Quaternion, i)[0] = 1.0;
            g.row_mut(Field::Visibility, i)[0] = relume_scene::light::UNOCCLUDED_SH0;
            g.row_mut(Field::Visibility, i)[2] = 1.0;
        }
        g.field_mut(Field::OpacityLogit).fill(6.0);
        g.field_mut(Field::MetalLogit).fill(-20.0);
        g.field_mut(Field::RoughLogit).fill(20.0);
        HostModel::new(Arc::new(Model::new(g, vec![[0.5; 3]], vec![[0.0; 3]; 8], (4, 2))))
    }

    fn view(model: &HostModel, eye: DVec3) -> RasterCamera {
        let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Y, 0.6, (33, 33)).unwrap();
        RasterCamera::new(&camera, &model.model().shading)
    }

    fn bulb(position: Vec3) -> Lamp {
        Lamp { points: vec![position], normal: None, cone: None, intensity: [1.0, 2.0, 0.5], radius: 0.0 }
    }

    /// Diffuse radiance of the middle pixel, seen from below the screen and from the side.
    fn middle(model: &HostModel, lamps: &[Lamp]) -> [f32; 3] {
        let view = view(model, DVec3::new(1.5, 0.0, 1.2));
        let of = |shadows| {
            let mut frame = model.lamp_frame(view, lamps.to_vec(), shadows);
            while frame.step() {}
            let [diffuse, _] = frame.into_planes();
            std::array::from_fn(|c| diffuse[3 * (16 * 33 + 16) + c])
        };
        let (at_gaussians, in_pixels): ([f32; 3], [f32; 3]) =
            (of(LampShadows::AtGaussians), of(LampShadows::InPixels));
        let apart = (0..3).map(|c| (at_gaussians[c] - in_pixels[c]).abs()).fold(0.0, f32::max);
        assert!(apart <= 0.15 * at_gaussians[1] + 0.01, "{at_gaussians:?} {in_pixels:?}");
        at_gaussians
    }

    #[test]
    fn radiance_falls_with_squared_distance_and_cosine() {
        let model = model(false);
        let [near, far] = [0.5, 1.0].map(|z| middle(&model, &[bulb([0.0, 0.0, z])]));
        let expected = 0.5 / PI / 0.25;
        // The Fresnel share of the highlight takes a few per cent of the diffuse part.
        assert!((0.85 * expected..1.02 * expected).contains(&near[0]), "{near:?} {expected}");
        assert!((near[1] / near[0] - 2.0).abs() < 1e-3 && (near[2] / near[0] - 0.5).abs() < 1e-3);
        assert!((near[0] / far[0] - 4.0).abs() < 0.1, "{near:?} {far:?}");
        let slanted = middle(&model, &[bulb([0.6, 0.0, 0.8])]);
        // The discs blended in the pixel are nearer to the lamp than its middle.
        assert!((slanted[0] / far[0] - 0.8).abs() < 0.1, "{slanted:?} {far:?}");
        assert_eq!(middle(&model, &[bulb([0.0, 0.0, -0.5])]), [0.0; 3], "a lamp below the floor");
    }

    #[test]
    fn occluders_up_to_the_lamp_cast_shadows() {
        let (open, screened) = (model(false), model(true));
        let above = bulb([0.0, 0.0, 0.8]);
        let below = bulb([0.0, 0.0, 0.2]);
        let of = |lamp: &Lamp| {
            middle(&screened, std::slice::from_ref(lamp))[0] / middle(&open, std::slice::from_ref(lamp))[0]
        };
        assert!(of(&above) < 0.1, "{}", of(&above));
        assert!((of(&below) - 1.0).abs() < 1e-3, "the screen is behind the lamp: {}", of(&below));
    }

    #[test]
    fn flat_lamps_and_cones_limit_the_light() {
        let model = model(false);
        let all = middle(&model, &[bulb([0.0, 0.0, 1.0])])[0];
        let with = |normal, cone| middle(&model, &[Lamp { normal, cone, ..bulb([0.0, 0.0, 1.0]) }])[0] / all;
        assert!((with(Some([0.0, 0.0, -1.0]), None) - 1.0).abs() < 0.01);
        assert!((with(Some([0.6, 0.0, -0.8]), None) - 0.8).abs() < 0.1);
        assert_eq!(with(Some([0.0, 0.0, 1.0]), None), 0.0);
        let cone = |axis: Vec3| Some(LampCone { axis, outer: 0.9, inner: 0.95 });
        assert!((with(None, cone([0.0, 0.0, -1.0])) - 1.0).abs() < 0.01);
        assert_eq!(with(None, cone([0.6, 0.0, -0.8])), 0.0);
        let two = middle(&model, &[bulb([0.0, 0.0, 1.0]), bulb([0.0, 0.0, 1.0])])[0];
        assert!((two / all - 2.0).abs() < 1e-4, "lamps add up");
    }
}
