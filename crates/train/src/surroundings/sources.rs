//! Sources of light in the surroundings, and the lights with shadows of their own in them.

use glam::{DVec3, Vec3};

use crate::surroundings::SurroundingLight;
use crate::surroundings::texels::Texels;
use relume_engine::TrainState;
use relume_scene::light::luminance;
use relume_scene::{SplitLight, softplus, texel_directions};

/// Least share of all light that a light with shadows of its own sends.
const MIN_LIGHT_SHARE: f32 = 0.03;
/// Smallest and largest angular radius of such a light, radians.
const MIN_LIGHT_RADIUS: f32 = 0.02;
const MAX_LIGHT_RADIUS: f32 = 0.35;

/// A connected region of clipped texels, each with the mean direction of its clipped pixels. In f32, which the text of a
/// checkpoint restores exactly.
pub(super) type Source = Vec<(usize, Vec3)>;

/// The connected regions of sources among `texels`. Columns are connected around the sphere.
pub(super) fn of(texels: &Texels) -> Vec<Source> {
    let (width, height) = texels.size;
    let mut left: Vec<bool> = (0..width * height).map(|t| texels.is_source(t)).collect();
    let mut sources = Vec::new();
    for first in 0..left.len() {
        if !std::mem::take(&mut left[first]) {
            continue;
        }
        let (mut region, mut next) = (vec![first], 0);
        while let Some(&t) = region.get(next) {
            next += 1;
            let (x, y) = (t % width, t / width);
            let beside = [(x + 1) % width, (x + width - 1) % width].map(|x| y * width + x);
            let above = y.checked_sub(1).map(|y| y * width + x);
            let below = (y + 1 < height).then_some((y + 1) * width + x);
            for near in beside.into_iter().chain(above).chain(below) {
                if std::mem::take(&mut left[near]) {
                    region.push(near);
                }
            }
        }
        sources.push(region.into_iter().map(|t| (t, texels.clipped_direction(t).as_vec3())).collect());
    }
    sources
}

impl SurroundingLight {
    /// The lights in the sources under the present environment of `state`, the strongest first, at most `most`. A light is the
    /// part of a source that exceeds white, as a disc of the same spread.
    pub fn lights(&self, state: &TrainState, most: usize) -> Vec<SplitLight> {
        let model = &state.model;
        let texels = texel_directions(model.env_width, model.env_height);
        let radiance = |t: usize| f64::from(luminance(model.env_raw[t].map(softplus)));
        let all: f64 = texels.iter().enumerate().map(|(t, (_, solid_angle))| radiance(t) * solid_angle).sum();
        let light = |source: &Source| {
            let (mut towards, mut power) = (DVec3::ZERO, 0.0);
            for (t, direction) in source {
                let excess = (radiance(*t) - 1.0).max(0.0) * texels[*t].1;
                towards += excess * direction.as_dvec3();
                power += excess;
            }
            // The mean direction over a disc of radius rho has the length 1 - rho^2 / 4.
            let radius = 2.0 * (1.0 - towards.length() / power.max(f64::MIN_POSITIVE)).max(0.0).sqrt();
            let direction = towards.normalize_or_zero().as_vec3().to_array();
            (power, SplitLight { direction, radius: (radius as f32).max(MIN_LIGHT_RADIUS) })
        };
        let is_strong = |(power, light): &(f64, SplitLight)| {
            *power > f64::from(MIN_LIGHT_SHARE) * all && light.radius < MAX_LIGHT_RADIUS
        };
        let mut strong: Vec<_> = self.sources.iter().map(light).filter(is_strong).collect();
        strong.sort_by(|a, b| b.0.total_cmp(&a.0));
        strong.into_iter().take(most).map(|(_, light)| light).collect()
    }
}
