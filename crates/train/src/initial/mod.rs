//! Initial Gaussians: from the capture's points, from the hull of its masks, or at the depths that its photographs determine.

mod plane_sweep;
mod rays;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::dataset::Dataset;
use crate::known_light::applied;
use crate::light_groups::RelativeLight;
use crate::{lights, materials};
use relume_capture::Capture;
use relume_engine::{Photo, PhotoSize, upward_share};
use relume_scene::light::{LightColour, SplitEnvironment};
use relume_scene::{
    Camera, Field, Framing, Gaussians, LightSplit, MAX_LIGHTS, Model, SplitLight, softplus, softplus_inverse,
    texel_directions,
};
use relume_spec::training::TrainConfig;

/// Voxels along an edge of the carved cube.
const HULL_SIDE: usize = 80;
/// Occluder reach without masks, scene radii: Gaussians farther away count as light and do not occlude.
const SURROUNDINGS: f32 = 0.5;
/// Mean radiance of the initial light, which is uniform over all directions.
const FIRST_LIGHT: f32 = 0.6;
/// Opacity of a new Gaussian.
const OPACITY: f32 = 0.3;

/// Position and display colour of an initial Gaussian.
type Seed = ([f32; 3], [f32; 3]);

/// The model at the start of training.
pub fn model(capture: &Capture, data: &Dataset, config: &TrainConfig, rng: &mut ChaCha8Rng) -> Model {
    let wanted = config.initial_gaussians as usize;
    let (seeds, spacing) = seeds(capture, data, wanted, rng);
    let mut gaussians = Gaussians::zeroed(
        seeds.len(),
        config.prototypes as usize,
        config.visibility_order as usize,
        config.radiance_order as usize,
    );
    let logit = |p: f32| (p / (1.0 - p)).ln();
    for (i, ((position, colour), spacing)) in seeds.iter().zip(&spacing).enumerate() {
        gaussians.row_mut(Field::Mean, i).copy_from_slice(position);
        gaussians.row_mut(Field::LogScale, i).fill(spacing.clamp(1e-4, 1.0).ln());
        gaussians.row_mut(Field::Quaternion, i)[0] = 1.0;
        gaussians.row_mut(Field::OpacityLogit, i)[0] = logit(OPACITY);
        gaussians.row_mut(Field::Visibility, i)[0] = relume_scene::light::UNOCCLUDED_SH0;
        for (s, c) in gaussians.row_mut(Field::Radiance, i).iter_mut().zip(colour) {
            *s = (c - 0.5) / 0.282_094_8;
        }
    }
    materials::reset_surface(&mut gaussians);
    let rows = config.environment_rows as usize;
    let mut shading = config.shading;
    if !data.has_alpha && shading.occluder_reach.is_none() {
        shading.occluder_reach = Some(SURROUNDINGS);
    }
    Model {
        gaussians,
        prototypes: vec![[0.5; 3]; config.prototypes as usize],
        env_raw: first_light(capture, config).repeat(data.lights.groups()),
        env_width: rows * 2,
        env_height: rows,
        lights: known_lights(capture, data, config),
        shading,
        world_scale: data.scale,
        world_offset: data.offset,
        framing: framing(capture),
        card: serde_json::Value::Null,
    }
}

/// The default view for captures without masks.
pub fn framing(capture: &Capture) -> Option<Framing> {
    let cameras: Vec<&Camera> = capture.train.iter().map(|view| &view.camera).collect();
    if capture.has_alpha { None } else { relume_capture::framing(&cameras) }
}

/// Sets the environment of each light group to a uniform light, given the colour of the mean light.
pub fn light_of_colour(model: &mut Model, mean: LightColour, groups: &[RelativeLight]) {
    let texels = model.env_texels();
    for (environment, group) in model.env_raw.chunks_mut(texels.max(1)).zip(groups) {
        environment.fill(group.colour_of(mean).rgb().map(|c| softplus_inverse(FIRST_LIGHT * c)));
    }
}

/// Colour of the light that the environment sends to a surface that faces up.
pub fn colour_from_above(model: &Model) -> LightColour {
    let texels = texel_directions(model.env_width, model.env_height);
    let mut sum = [1e-6f32; 3];
    for (raw, texel) in model.env_raw.iter().zip(&texels) {
        (0..3).for_each(|c| sum[c] += upward_share(texel) * softplus(raw[c]));
    }
    LightColour::of(sum)
}

/// The environment at the start of training, before the softplus: the measured light of the photographs if it is
/// known.
fn first_light(capture: &Capture, config: &TrainConfig) -> Vec<[f32; 3]> {
    let rows = config.environment_rows as usize;
    let (Some(map), Some(light)) = (&capture.measured_light, &config.light) else {
        return vec![[softplus_inverse(FIRST_LIGHT); 3]; 2 * rows * rows];
    };
    applied(light, map).resampled(2 * rows, rows).texels().iter().map(|t| t.map(softplus_inverse)).collect()
}

/// The strong small lights of a known light.
fn known_lights(capture: &Capture, data: &Dataset, config: &TrainConfig) -> LightSplit {
    let (Some(map), Some(light)) = (&capture.measured_light, &config.light) else {
        return LightSplit::default();
    };
    if config.lights == 0 || !config.shading.shades_lights() || !data.lights.is_static() {
        return LightSplit::default();
    }
    let rows = config.environment_rows as usize;
    let found = SplitEnvironment::new(&applied(light, map), MAX_LIGHTS);
    let lights: Vec<SplitLight> = found.lights.iter().map(SplitLight::from).collect();
    lights::split(&lights, 2 * rows, rows)
}

/// Positions with display colours, and the standard deviation of each.
fn seeds(capture: &Capture, data: &Dataset, wanted: usize, rng: &mut ChaCha8Rng) -> (Vec<Seed>, Vec<f32>) {
    let in_model = |p: glam::DVec3| ((p + data.offset) * data.scale).as_vec3().to_array();
    let hull = if data.has_alpha { hull_surface(data) } else { Vec::new() };
    let mut seeds: Vec<Seed> = if capture.points.len() >= 100 {
        let step = (capture.points.len() as f64 / wanted as f64).max(1.0);
        let count = capture.points.len().min(wanted);
        let pick = |i: usize| &capture.points[(i as f64 * step) as usize];
        let display = |c: [f32; 3]| c.map(|v| relume_engine::srgb(v.clamp(0.0, 1.0)));
        (0..count).map(|i| (in_model(pick(i).0), display(pick(i).1))).collect()
    } else if hull.is_empty() {
        rays::seeds(data, wanted, rng)
    } else {
        let cell = 2.0 / HULL_SIDE as f32;
        let jitter = |rng: &mut ChaCha8Rng| (rng.random::<f32>() - 0.5) * cell;
        let centres = (0..wanted).map(|_| hull[rng.random_range(0..hull.len())]).collect::<Vec<_>>();
        centres.into_iter().map(|c| (c.map(|v| v + jitter(rng)), [0.5; 3])).collect()
    };
    if capture.points.len() < 100 && !hull.is_empty() {
        show_mean_colours(data, &mut seeds);
    }
    let spacing = nearest_neighbour_distance(&seeds);
    (seeds, spacing)
}

/// Pixel of `photo` that shows a point; `None` if the point is behind the camera or outside the image.
fn pixel_of(photo: &Photo, p: [f32; 3]) -> Option<usize> {
    let c = &photo.camera;
    let x = c.rotation * glam::DVec3::new(p[0].into(), p[1].into(), p[2].into()) + c.translation;
    if x.z < 0.05 {
        return None;
    }
    let (u, v) = (c.fx * x.x / x.z + c.cx, c.fy * x.y / x.z + c.cy);
    let inside = u >= 0.0 && v >= 0.0 && u < f64::from(c.width) && v < f64::from(c.height);
    inside.then(|| v as usize * c.width as usize + u as usize)
}

/// Gives each seed the mean colour of the pixels that show it.
fn show_mean_colours(data: &Dataset, seeds: &mut [Seed]) {
    let mut sums = vec![([0.0f32; 3], 0.0f32); seeds.len()];
    data.for_each_photo(PhotoSize::Half, |_, photo| {
        for ((sum, n), (p, _)) in sums.iter_mut().zip(seeds.iter()) {
            if let Some(i) = pixel_of(photo, *p) {
                (0..3).for_each(|k| sum[k] += photo.pixels[i][k]);
                *n += 1.0;
            }
        }
    });
    for ((_, colour), (sum, n)) in seeds.iter_mut().zip(sums) {
        *colour = if n > 0.0 { sum.map(|s| s / n) } else { [0.5; 3] };
    }
}

/// Centres of the voxels on the surface of the visual hull, in the cube around the unit ball (normalised world).
fn hull_surface(data: &Dataset) -> Vec<[f32; 3]> {
    use rayon::prelude::*;
    let n = HULL_SIDE;
    let centre = |i: usize| {
        let at = |k: usize| -1.0 + (2 * k + 1) as f32 / n as f32;
        [at(i % n), at(i / n % n), at(i / (n * n))]
    };
    // For each voxel: the number of photographs that see it, and the number of those whose mask is empty there.
    let mut counts = vec![[0u32; 2]; n * n * n];
    data.for_each_photo(PhotoSize::Half, |_, photo| {
        counts.par_iter_mut().with_min_len(4096).enumerate().for_each(|(i, [seen, missed])| {
            if let Some(pixel) = pixel_of(photo, centre(i)) {
                *seen += 1;
                *missed += u32::from(photo.alpha[pixel] < 0.3);
            }
        });
    });
    // A few misses are allowed, because masks are blurred at half resolution.
    let solid: Vec<bool> = counts.iter().map(|[seen, missed]| *seen >= 3 && missed * 40 <= *seen).collect();
    let open = |i: usize, axis: usize, step: isize| {
        let stride = [1, n, n * n][axis];
        let k = (i / stride % n) as isize + step;
        if k < 0 || k >= n as isize { true } else { !solid[(i as isize + step * stride as isize) as usize] }
    };
    let surface = |i: &usize| (0..3).any(|a| open(*i, a, 1) || open(*i, a, -1));
    (0..n * n * n).filter(|i| solid[*i]).filter(surface).map(centre).collect()
}

/// Distance of each seed to its nearest neighbours: root mean square over three, from a hash grid whose cell size
/// limits it.
fn nearest_neighbour_distance(seeds: &[Seed]) -> Vec<f32> {
    use rayon::prelude::*;
    use std::collections::HashMap;
    let extent = seeds.iter().flat_map(|(p, _)| p).fold(0.0f32, |m, v| m.max(v.abs())).max(1e-6);
    let cell = (2.0 * extent / (seeds.len() as f32).cbrt()).max(1e-6);
    let key = |p: &[f32; 3]| p.map(|v| (v / cell).floor() as i32);
    let mut grid: HashMap<[i32; 3], Vec<usize>> = HashMap::new();
    for (i, (p, _)) in seeds.iter().enumerate() {
        grid.entry(key(p)).or_default().push(i);
    }
    seeds
        .par_iter()
        .enumerate()
        .map(|(i, (p, _))| {
            let k = key(p);
            let mut nearest = [cell * cell; 3];
            for offset in 0..27 {
                let at = [k[0] + offset % 3 - 1, k[1] + offset / 3 % 3 - 1, k[2] + offset / 9 - 1];
                // The order of a cell's members is the order of insertion, so this is deterministic.
                for &j in grid.get(&at).into_iter().flatten() {
                    let d = (0..3).map(|a| (p[a] - seeds[j].0[a]).powi(2)).sum::<f32>();
                    if j != i && d < nearest[2] {
                        nearest[2] = d;
                        nearest.sort_unstable_by(f32::total_cmp);
                    }
                }
            }
            (nearest.iter().sum::<f32>() / 3.0).sqrt()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use relume_engine::PhotoLight;
    use relume_scene::DisplayRange;

    /// Height of a point above the wall of [`painted_plane`].
    pub(super) fn wall(p: DVec3) -> f64 {
        p.z - 0.1 * p.x
    }

    /// Photographs of `size` pixels of a wall through the origin, from 8 places at a distance of 2; `contrast` scales its pattern.
    pub(super) fn painted_plane(size: u32, contrast: f64) -> Vec<Photo> {
        let from = |k: usize| {
            let turn = std::f64::consts::TAU * k as f64 / 8.0;
            let eye = DVec3::new(0.35 * turn.cos(), 0.35 * turn.sin(), 2.0);
            let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::Y, 0.9, (size, size)).unwrap();
            let pixel = |i: u32| {
                let ray = camera.ray(i % size, i / size);
                let p = eye - ray * (wall(eye) / wall(ray));
                let wave = |a: f64, b: f64| (a * p.x + b * p.y).sin();
                let value = 0.5 + contrast * 0.1 * (wave(17.0, 5.0) + wave(-7.0, 19.0) + wave(3.1, -8.3));
                [value as f32; 3]
            };
            let pixels: Vec<_> = (0..size * size).map(pixel).collect();
            let (light, range) = (PhotoLight::default(), DisplayRange::Unit);
            Photo { camera, pixels, alpha: Vec::new(), light, range }
        };
        (0..8).map(from).collect()
    }
}
