//! Light on a horizontal plane below a model (docs/MODEL.md, section 9).
//!
//! Each direction of light has a picture: the model as the plane sees it along the direction, orthographic. All points of the plane read
//! the same pictures.

use glam::DVec3;
use multiversion::multiversion;
use rayon::prelude::*;

use crate::NO_INDIRECT_BASIS;
use crate::cpu::lanes::exp_negative;
use crate::cpu::occluder::{Footprint, Occluder, Vec3, dot, occluders, plane_basis};
use crate::cpu::{HostLight, HostModel, outward_normals};
use relume_layout::constants::ALPHA_MAX;
use relume_scene::light::LightCell;
use relume_scene::{Field, opaque_centre, opaque_radius};

/// Most pictures that are in memory at the same time.
const GROUP: usize = 32;
/// Gaussians of a group of pictures together.
const GROUP_GAUSSIANS: usize = 640_000;
/// Texels of a group of pictures together.
const GROUP_TEXELS: usize = 8 << 20;
/// Radius of the ball in which the model is searched, normalised world.
const REACH: f64 = 4.0;
/// Radius of a model with too few opaque Gaussians, normalised world.
const DEFAULT_RADIUS: f32 = 1.2;
/// Least number of texels along a side of a picture.
const MIN_SIDE: f32 = 64.0;
/// Texels of a row that are computed together.
const ROW: usize = 64;
/// Share of the occluders that the pictures contain completely.
const WITHIN: f32 = 0.995;
/// Standard deviations up to which an occluder is in the pictures.
const EDGE: f32 = 3.0;
/// Greatest deviation that counts, radii of the ball.
const MAX_DEVIATION: f32 = 0.1;

/// The Gaussians of a model above a horizontal plane, as occluders of its light.
pub struct Ground {
    /// Gaussians above the plane, with their numbers.
    occluders: Vec<(usize, Occluder)>,
    centre: Vec3,
    radius: f32,
}

/// What a point of the plane sees of the model: sums or means over directions.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct GroundView {
    /// Transmittance; its mean is the ambient occlusion.
    pub open: f32,
    /// Radiance from the model.
    pub radiance: [f32; 3],
}

impl HostModel {
    /// The model above the plane z = `height`, normalised world.
    pub fn ground(&self, height: f32) -> Ground {
        let source = self.source(&[], &[], &NO_INDIRECT_BASIS);
        let above = |(_, o): &(usize, Occluder)| o.occludes() && o.mean[2] > height;
        let occluders: Vec<_> = occluders(&source).into_iter().enumerate().filter(above).collect();
        let gaussians = &self.model().gaussians;
        let centre = opaque_centre(gaussians, DVec3::ZERO, REACH).unwrap_or_default();
        let ball = opaque_radius(gaussians, centre, REACH).map_or(DEFAULT_RADIUS, |radius| radius as f32);
        let centre = centre.to_array().map(|v| v as f32);
        let radius = reach(&occluders, centre, ball);
        Ground { occluders, centre, radius }
    }
}

/// Radius around `centre` that contains nearly all of the occluders whose means lie in a ball, to [`EDGE`] of their deviations.
fn reach(occluders: &[(usize, Occluder)], centre: Vec3, ball: f32) -> f32 {
    let far = |(_, o): &(usize, Occluder)| {
        let offset: Vec3 = std::array::from_fn(|k| o.mean[k] - centre[k]);
        let distance = dot(offset, offset).sqrt();
        let widest = o.axes.iter().map(|axis| dot(*axis, *axis)).fold(0.0, f32::max).sqrt();
        (distance <= ball).then(|| distance + EDGE * widest.min(MAX_DEVIATION * ball))
    };
    let mut reaches: Vec<f32> = occluders.iter().filter_map(far).collect();
    reaches.sort_unstable_by(f32::total_cmp);
    let last = (reaches.len() as f32 * WITHIN) as usize;
    reaches.get(last.min(reaches.len().saturating_sub(1))).map_or(ball, |reach| *reach)
}

impl GroundView {
    /// The sums of `count` directions as means.
    #[must_use]
    pub fn mean(self, count: usize) -> Self {
        let share = 1.0 / count.max(1) as f32;
        Self { open: self.open * share, radiance: self.radiance.map(|v| v * share) }
    }
}

/// The radiance that a model sends to the plane under a light.
pub struct GroundRadiance<'a> {
    light: &'a HostLight,
    outward: Vec<Vec3>,
}

impl<'a> GroundRadiance<'a> {
    /// The radiance of the model of `light`.
    pub fn new(light: &'a HostLight) -> Self {
        Self { light, outward: outward_normals(&light.source()) }
    }

    /// Radiance that Gaussian `i` sends in direction `-d`, towards the plane. It is 0 for surfaces that no photograph shows: Gaussians with a
    /// negative sampling rate, and the inner sides of surfaces.
    fn sent(&self, i: usize, d: Vec3) -> [f32; 3] {
        let is_hidden = self.light.source().gaussians.row(Field::SamplingRate, i)[0] < 0.0;
        if is_hidden || dot(self.outward[i], d) >= 0.0 { [0.0; 3] } else { self.light.outgoing(i, d).total() }
    }
}

impl Ground {
    /// The Gaussians above the plane.
    pub(super) fn occluders(&self) -> impl Iterator<Item = Occluder> + '_ {
        self.occluders.iter().map(|(_, occluder)| *occluder)
    }

    /// Number of directions to compute together, whose pictures have `side` texels along a side: a call takes a fraction of a second, and its
    /// pictures at most 32 MiB.
    pub fn group(&self, side: usize) -> usize {
        let by_time = GROUP_GAUSSIANS / self.occluders.len().max(1);
        by_time.min(GROUP_TEXELS / (side * side).max(1)).clamp(2, GROUP)
    }

    /// Adds to `sums`, for each of `points` of the plane, the irradiance of `cells` that passes the model. The pictures of the model have at
    /// most `side` texels along a side, fewer for large cells.
    pub fn add_irradiance(&self, sums: &mut [[f32; 3]], points: &[Vec3], cells: &[LightCell], side: usize) {
        let pictures: Vec<Picture<1>> = cells
            .par_iter()
            .map(|cell| {
                let side = side_for(cell.solid_angle).min(side);
                self.picture(cell.direction, side, |_, _| [], |[left], [], alpha| [left * (1.0 - alpha)])
            })
            .collect();
        sums.par_iter_mut().zip(points).with_min_len(256).for_each(|(sum, point)| {
            for (picture, cell) in pictures.iter().zip(cells) {
                let [left] = picture.at(*point);
                (0..3).for_each(|c| sum[c] += left * cell.irradiance[c]);
            }
        });
    }

    /// Adds to `sums`, for each of `points` of the plane, what it sees of the model in each of `directions`, with the radiance of `light`.
    pub fn add_views(
        &self,
        sums: &mut [GroundView],
        points: &[Vec3],
        directions: &[Vec3],
        light: Option<&GroundRadiance<'_>>,
        side: usize,
    ) {
        let sent = |i: usize, d: Vec3| light.map_or([0.0; 3], |light| light.sent(i, d));
        let blend = |[left, r, g, b]: [f32; 4], [x, y, z]: [f32; 3], alpha: f32| {
            let weight = left * alpha;
            [left - weight, r + weight * x, g + weight * y, b + weight * z]
        };
        let pictures: Vec<Picture<4>> =
            directions.par_iter().map(|d| self.picture(*d, side, sent, blend)).collect();
        sums.par_iter_mut().zip(points).with_min_len(256).for_each(|(sum, point)| {
            for picture in &pictures {
                let [open, radiance @ ..] = picture.at(*point);
                sum.open += open;
                (0..3).for_each(|c| sum.radiance[c] += radiance[c]);
            }
        });
    }

    /// The picture along `d`. The Gaussians are blended from the plane on; `sent` is what a Gaussian sends towards the plane.
    fn picture<const N: usize, const M: usize>(
        &self,
        d: Vec3,
        side: usize,
        sent: impl Fn(usize, Vec3) -> [f32; M],
        blend: impl Fn([f32; N], [f32; M], f32) -> [f32; N],
    ) -> Picture<N> {
        let (u, v) = plane_basis(d);
        let low = [dot(self.centre, u) - self.radius, dot(self.centre, v) - self.radius];
        let mut picture = Picture::new([u, v], low, 2.0 * self.radius / side as f32, side);
        let mut nearest: Vec<(f32, usize)> =
            self.occluders.iter().enumerate().map(|(k, (_, o))| (dot(o.mean, d), k)).collect();
        nearest.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for (_, k) in nearest {
            let (i, occluder) = &self.occluders[k];
            let Some(seen) = occluder.along(d, u, v) else { continue };
            let of_gaussian = sent(*i, d);
            picture.splat(&seen, [dot(occluder.mean, u), dot(occluder.mean, v)], |texel, alpha| {
                blend(texel, of_gaussian, alpha)
            });
        }
        picture
    }
}

/// Texels along a side of the picture for a cell of light. A large cell casts a soft shadow, which needs few texels: a texel is 0.3 of the
/// width of the cell at the distance of the model's radius.
fn side_for(solid_angle: f32) -> usize {
    (2.0 / (0.3 * solid_angle.max(0.0).sqrt())).max(MIN_SIDE) as usize
}

/// A square picture of a model along one direction. The first value of a texel is the transmittance, the others are radiance.
struct Picture<const N: usize> {
    axes: [Vec3; 2],
    /// Low corner in the plane of the axes.
    low: [f32; 2],
    /// Texels per unit of length.
    per_unit: f32,
    texel: f32,
    side: usize,
    texels: Vec<[f32; N]>,
}

impl<const N: usize> Picture<N> {
    /// A texel without Gaussians: transmittance 1, radiance 0.
    const EMPTY: [f32; N] = {
        let mut empty = [0.0; N];
        empty[0] = 1.0;
        empty
    };

    fn new(axes: [Vec3; 2], low: [f32; 2], texel: f32, side: usize) -> Self {
        Self { axes, low, per_unit: 1.0 / texel, texel, side, texels: vec![Self::EMPTY; side * side] }
    }

    /// Blends a footprint into the texels whose centres it covers.
    fn splat(&mut self, seen: &Footprint, centre: [f32; 2], blend: impl Fn([f32; N], f32) -> [f32; N]) {
        let offset = |k: usize, i: usize| self.low[k] + (i as f32 + 0.5) * self.texel - centre[k];
        let reach = seen.extent()[1];
        let mut alphas = [0.0f32; ROW];
        for y in self.covered(1, centre[1] - reach, centre[1] + reach) {
            let dy = offset(1, y);
            let Some([from, to]) = seen.chord(dy) else { continue };
            let columns = self.covered(0, centre[0] + from, centre[0] + to);
            for first in columns.clone().step_by(ROW) {
                let columns = first..columns.end.min(first + ROW);
                let alphas = &mut alphas[..columns.len()];
                row_alphas(seen, [offset(0, first), dy], self.texel, alphas);
                let texels = &mut self.texels[y * self.side..][columns];
                texels.iter_mut().zip(alphas).for_each(|(texel, alpha)| *texel = blend(*texel, *alpha));
            }
        }
    }

    /// The columns (`axis` 0) or rows whose centres lie from `from` to `to`.
    fn covered(&self, axis: usize, from: f32, to: f32) -> std::ops::Range<usize> {
        // Texel i has its centre at low + (i + 1/2) texel.
        let place = |x: f32| (x - self.low[axis]) * self.per_unit - 0.5;
        let (first, last) = (place(from).ceil().max(0.0) as usize, place(to).floor());
        // NaN and places before the picture give no texel.
        first..if last >= 0.0 { (last as usize + 1).min(self.side) } else { 0 }
    }

    /// The value where the ray from `point` along the direction meets the picture, bilinear; empty outside.
    #[inline]
    fn at(&self, point: Vec3) -> [f32; N] {
        let [x, y] = std::array::from_fn(|k| (dot(point, self.axes[k]) - self.low[k]) * self.per_unit - 0.5);
        let end = (self.side - 1) as f32;
        // NaN is outside.
        if !(x >= 0.0 && y >= 0.0 && x < end && y < end) {
            return Self::EMPTY;
        }
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f32, y - row as f32);
        let at = row * self.side + column;
        let [a, b] = [self.texels[at], self.texels[at + 1]];
        let [c, d] = [self.texels[at + self.side], self.texels[at + self.side + 1]];
        std::array::from_fn(|k| {
            let (top, bottom) = (a[k] + fx * (b[k] - a[k]), c[k] + fx * (d[k] - c[k]));
            top + fy * (bottom - top)
        })
    }
}

/// Alpha of a footprint at offsets from its centre, `step` apart along the row that begins at `first`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
fn row_alphas(seen: &Footprint, first: [f32; 2], step: f32, alphas: &mut [f32]) {
    let ([a, b, c], [x, dy]) = (seen.conic, first);
    let (opacity, reach) = (seen.opacity, seen.reach);
    for (k, alpha) in alphas.iter_mut().enumerate() {
        let dx = x + k as f32 * step;
        let power = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy;
        let positive = if power > 0.0 { power } else { 0.0 };
        let value = opacity * exp_negative(-positive);
        let limited = if value < ALPHA_MAX { value } else { ALPHA_MAX };
        *alpha = if power <= reach { limited } else { 0.0 };
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::cpu::OccluderBvh;
    use crate::{ProbeSettings, fibonacci_sphere};
    use relume_scene::{EnvMap, Gaussians, Model, ShadingOptions};

    /// A ball of small opaque Gaussians around (0, 0, 1/2).
    fn ball() -> HostModel {
        let mut g = Gaussians::zeroed(400, 1, 2, 0);
        for i in 0..400 {
            let d = fibonacci_sphere(400)[i];
            g.row_mut(Field::Mean, i).copy_from_slice(&[0.4 * d[0], 0.4 * d[1], 0.5 + 0.4 * d[2]]);
        }
        g.field_mut(Field::LogScale).fill(0.04f32.ln());
        g.field_mut(Field::OpacityLogit).fill(4.0);
        for i in 0..400 {
            g.row_mut(Field::Quaternion, i)[0] = 1.0;
            g.row_mut(Field::Visibility, i)[0] = relume_scene::light::UNOCCLUDED_SH0;
        }
        HostModel::new(Arc::new(Model::new(g, vec![[0.5; 3]], vec![[0.0; 3]; 8], (4, 2))))
    }

    fn points() -> Vec<Vec3> {
        (0..400).map(|i| [(i % 20) as f32 * 0.1 - 0.95, (i / 20) as f32 * 0.1 - 0.95, 0.0]).collect()
    }

    #[test]
    fn irradiance_of_a_direction_is_the_transmittance_of_rays() {
        let model = ball();
        let direction = glam::Vec3::new(0.5, 0.2, 0.7).normalize().to_array();
        let cell = LightCell { direction, irradiance: [1.0, 2.0, 0.5], solid_angle: 1e-5, is_of_light: true };
        let mut found = vec![[0.0; 3]; points().len()];
        model.ground(0.0).add_irradiance(&mut found, &points(), &[cell], 512);
        let options = ShadingOptions::default();
        let source = model.source(&[], &[], &NO_INDIRECT_BASIS);
        let source = crate::cpu::AttributeSource { options: &options, ..source };
        let rays = OccluderBvh::new(
            &source,
            ProbeSettings { bias: 0.0, clearance: 0.0, ..ProbeSettings::default() },
        );
        let mut hidden = 0;
        for (point, found) in points().iter().zip(&found) {
            let left = rays.transmittance(*point, direction);
            assert!((found[0] - left).abs() < 0.06, "{point:?}: {found:?} {left}");
            assert_eq!((found[1], found[2]), (2.0 * found[0], 0.5 * found[0]));
            hidden += usize::from(left < 0.1);
        }
        assert!((20..100).contains(&hidden), "the control: {hidden} points in shadow");
    }

    #[test]
    fn points_near_the_model_see_less_sky_and_more_model() {
        let model = Arc::new(ball());
        let light = model.prepare_light(model.light_tables(&EnvMap::constant(16, 8, [1.0; 3]).into()));
        let directions: Vec<Vec3> = fibonacci_sphere(256).into_iter().filter(|d| d[2] > 0.0).collect();
        let near_and_far = [[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [3.0, 0.0, 0.0]];
        let ground = model.ground(0.0);
        let radiance = GroundRadiance::new(&light);
        let views = |light: Option<&GroundRadiance<'_>>| {
            let mut sums = [GroundView::default(); 3];
            directions
                .chunks(50)
                .for_each(|some| ground.add_views(&mut sums, &near_and_far, some, light, 128));
            sums.map(|sum| sum.mean(directions.len()))
        };
        let (dark, views) = (views(None), views(Some(&radiance)));
        assert!(views[0].open < 0.6 && views[1].open > views[0].open && views[2].open > 0.98, "{views:?}");
        assert!(views[0].radiance[0] > views[1].radiance[0] && views[1].radiance[0] > views[2].radiance[0]);
        // A surface of albedo 1/2 sends less than half of the light of the sky.
        assert!(views.iter().all(|view| view.radiance[0] <= 0.5 * (1.0 - view.open) + 1e-3), "{views:?}");
        assert!(
            dark.iter().zip(&views).all(|(dark, view)| dark.radiance == [0.0; 3] && dark.open == view.open)
        );
    }

    #[test]
    fn gaussians_below_the_plane_do_not_count() {
        let model = ball();
        let cell = LightCell {
            direction: [0.0, 0.0, 1.0],
            irradiance: [1.0; 3],
            solid_angle: 1e-5,
            is_of_light: true,
        };
        let above = |height: f32| {
            let mut sums = [[0.0; 3]];
            model.ground(height).add_irradiance(&mut sums, &[[0.0, 0.0, height]], &[cell], 256);
            sums[0][0]
        };
        assert_eq!(above(1.1), 1.0);
        assert!(above(0.0) < 0.2, "the control: {}", above(0.0));
        let empty = Model::new(Gaussians::zeroed(0, 1, 2, 0), vec![[0.5; 3]], vec![[0.0; 3]; 8], (4, 2));
        let empty = HostModel::new(Arc::new(empty));
        let mut found = [[0.0; 3]; 2];
        empty.ground(0.0).add_irradiance(&mut found, &[[f32::NAN; 3], [0.0; 3]], &[cell], 16);
        assert_eq!(found, [[1.0; 3]; 2]);
    }
}
