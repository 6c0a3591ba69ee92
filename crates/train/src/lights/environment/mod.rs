//! Solves for the whole environment by the shading and the shadows of neighbouring surfaces.
//!
//! Under the true light, a surface colour divided by its irradiance has only the edges of the material. With measured visibility the
//! irradiance is linear in the light, so the ratios of neighbouring colours determine the light of all directions together, for any
//! number of lights of any size. What they leave open follows the present environment.

mod solver;
mod transport;
mod variation;

use glam::DVec3;

use crate::lights::LightSearch;
use relume_engine::{TrainState, fibonacci_sphere};
use relume_scene::{DisplayRange, LightSplit, SplitLight, softplus, softplus_inverse, texel_directions};
use solver::Prior;
use transport::Transport;
use variation::Variation;

/// Number of directions of the environment, evenly spread: 13 degrees apart.
const DIRECTIONS: usize = 256;
/// Sharpness of the kernel that converts between directions and texels: `exp(KERNEL (cos - 1))`.
const KERNEL: f64 = 0.5 * DIRECTIONS as f64;
/// Least radiance of a texel, the range of the softplus.
const MIN_RADIANCE: f32 = 1e-3;

/// Replaces the environment of `state` by the solution, in which `split` has the dominant lights. `gathered`: light that each Gaussian receives
/// from other surfaces. `seen`: number of pixels in which each Gaussian is visible. `range`: range of the photographs. The solver keeps the mean irradiance of the visible surfaces in each channel. It
/// does not change the environment if fewer than two neighbouring Gaussians are visible.
pub fn solve(
    state: &mut TrainState,
    gathered: &[[f32; 6]],
    seen: &[f32],
    range: DisplayRange,
    split: &LightSplit,
) {
    let search = LightSearch::new(state, seen, range);
    let sky = sky_directions(split);
    if search.neighbours.members().len() < 2 || sky.is_empty() {
        return;
    }
    let transport = Transport::measure(&search, &sky, &split.lights);
    let variation = Variation::of(&search, gathered, seen);
    let prior = Prior { light: present(state, &sky, split), sky: sky.len() };
    let solution = solver::solve(&transport, &variation, &prior);
    state.model.env_raw = environment(state, &sky, split, &solution);
}

/// The directions of the environment that do not belong to a dominant light.
fn sky_directions(split: &LightSplit) -> Vec<[f32; 3]> {
    let is_sky = |d: &[f32; 3]| {
        let to = DVec3::from(d.map(f64::from));
        let angle = |light: &SplitLight| to.angle_between(DVec3::from(light.direction.map(f64::from)));
        split.lights.iter().all(|light| angle(light) > super::split::REACH + f64::from(light.radius))
    };
    fibonacci_sphere(DIRECTIONS).into_iter().filter(is_sky).collect()
}

/// The share of texel `t` that belongs to no dominant light.
fn sky_share(split: &LightSplit, t: usize) -> f32 {
    if split.is_empty() { 1.0 } else { split.rest(t) }
}

/// The present environment: the radiance of each direction of `sky`, then the irradiance of each dominant light.
fn present(state: &TrainState, sky: &[[f32; 3]], split: &LightSplit) -> Vec<[f32; 3]> {
    let model = &state.model;
    let texels = texel_directions(model.env_width, model.env_height);
    let radiance: Vec<[f32; 3]> = model.env_raw.iter().map(|raw| raw.map(softplus)).collect();
    let sources = texels.iter().enumerate().map(|(t, (d, area))| (*d, area * f64::from(sky_share(split, t))));
    let sources: Vec<(DVec3, f64)> = sources.collect();
    let mut light: Vec<[f32; 3]> = sky.iter().map(|d| blend(*d, &sources, &radiance)).collect();
    for k in 0..split.lights.len() {
        let mut power = [0.0; 3];
        for (t, (_, area)) in texels.iter().enumerate() {
            (0..3).for_each(|c| power[c] += split.shares[t][k] * *area as f32 * radiance[t][c]);
        }
        light.push(power);
    }
    light
}

/// The raw environment in which `light` has the radiance of each direction of `sky`, then the irradiance of each dominant light.
fn environment(
    state: &TrainState,
    sky: &[[f32; 3]],
    split: &LightSplit,
    light: &[[f32; 3]],
) -> Vec<[f32; 3]> {
    let texels = texel_directions(state.model.env_width, state.model.env_height);
    let (sky_light, powers) = light.split_at(sky.len());
    let area_of = |k: usize| {
        let areas = texels.iter().enumerate().map(|(t, (_, area))| split.shares[t][k] * *area as f32);
        areas.sum::<f32>().max(1e-6)
    };
    let areas: Vec<f32> = (0..powers.len()).map(area_of).collect();
    let sources: Vec<(DVec3, f64)> = sky.iter().map(|d| (DVec3::from(d.map(f64::from)), 1.0)).collect();
    let texel = |(t, (d, _)): (usize, &(DVec3, f64))| {
        let around = blend(d.as_vec3().to_array(), &sources, sky_light);
        std::array::from_fn(|c| {
            let of_lights: f32 =
                (0..powers.len()).map(|k| split.shares[t][k] * powers[k][c] / areas[k]).sum();
            softplus_inverse((sky_share(split, t) * around[c] + of_lights).max(MIN_RADIANCE))
        })
    };
    texels.iter().enumerate().map(texel).collect()
}

/// Mean of `values` around a direction; `sources` are their directions and weights.
fn blend(direction: [f32; 3], sources: &[(DVec3, f64)], values: &[[f32; 3]]) -> [f32; 3] {
    let to = DVec3::from(direction.map(f64::from));
    let (mut sum, mut all) = ([0.0f64; 3], 0.0);
    for ((from, area), value) in sources.iter().zip(values) {
        let weight = (KERNEL * (to.dot(*from) - 1.0)).exp() * area;
        (0..3).for_each(|c| sum[c] += weight * f64::from(value[c]));
        all += weight;
    }
    sum.map(|s| (s / all.max(f64::MIN_POSITIVE)) as f32)
}

#[cfg(test)]
mod tests;
