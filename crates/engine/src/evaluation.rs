//! Images and measurements of a training state, without gradients, for the decisions of a training. The host computes them
//! whichever device trains, so that both engines decide by the same code.

use std::borrow::Cow;

use crate::cpu::training::{self, environment_radiance, tables_of};
use crate::cpu::{
    self, AttributeSource, Pass, Probes, Splat, SurfaceShader, Transport, outward_normals, radiance_image,
    sky_irradiance,
};
use crate::step::{Branches, Photo};
use crate::{
    NO_INDIRECT_BASIS, PhotoLight, PhotoLights, ProbeSettings, RasterCamera, TrainState, TurnedLight,
    fibonacci_sphere, indirect_basis,
};
use relume_layout::channel::Channels;
use relume_layout::constants::EarlyStop;
use relume_scene::light::{EnvOperators, LightTables};
use relume_scene::{Camera, ColumnShift, Model, SplitLight};

/// The state as kernel input, without learned indirect light and with the light of the first block.
pub fn source(state: &TrainState) -> AttributeSource<'_> {
    training::source(state, &NO_INDIRECT_BASIS, PhotoLight::default())
}

/// The physically based branch from the camera and under the light of `photo`: display values in the range of `photo`.
pub fn physical_image(
    state: &TrainState,
    operators: &EnvOperators,
    photo: &Photo,
    branches: Branches,
    background: [f32; 3],
) -> Vec<[f32; 3]> {
    let model = &state.model;
    let tables = tables_of(model, operators, photo.light.light);
    let basis = indirect_basis(&tables);
    let sh_degree = model.gaussians.visibility_degree();
    let shader = SurfaceShader { tables: &tables, options: &model.shading, sh_degree, range: photo.range };
    let source = training::source(state, &basis, photo.light).under(shader);
    let channels = branches.channels(&model.gaussians, &model.shading).blended;
    let pass = Pass::forward(
        &source,
        RasterCamera::new(&photo.camera, source.options),
        channels,
        EarlyStop::WhenSaturated,
    );
    shader.images(&pass, background).physical
}

/// Mean squared error of the physically based branch on one photograph.
pub fn physical_error(
    state: &TrainState,
    operators: &EnvOperators,
    photo: &Photo,
    branches: Branches,
    background: [f32; 3],
) -> f32 {
    mean_squared_error(&physical_image(state, operators, photo, branches, background), photo)
}

/// The radiance branch seen by `camera`, display-referred.
pub fn radiance(state: &TrainState, camera: &Camera, background: [f32; 3]) -> Vec<[f32; 3]> {
    radiance_image(&colour_pass(state, camera), background)
}

/// Mean squared error of the radiance branch on one photograph.
pub fn radiance_error(state: &TrainState, photo: &Photo, background: [f32; 3]) -> f32 {
    mean_squared_error(&radiance(state, &photo.camera, background), photo)
}

/// Summed blending weight of each Gaussian, in pixels, in the image of `camera`.
pub fn blending_weights(state: &TrainState, camera: &Camera) -> Vec<f32> {
    let pass = colour_pass(state, camera);
    let mut out = vec![0.0; state.model.gaussians.len()];
    for (splat, label) in pass.splats.iter().zip(cpu::backward_labels(&pass)) {
        out[splat.gaussian as usize] = label.weight;
    }
    out
}

/// Share of each Gaussian's footprint in the image of `camera` that other Gaussians do not hide, 0 to 1: its summed blending weight
/// divided by the weight that it would have alone, which is at most the number of pixels. A Gaussian whose centre is outside of the
/// image counts as visible if it has a weight of half a pixel. `None` for a Gaussian that no pixel can show.
pub fn visible_shares(state: &TrainState, camera: &Camera) -> Vec<Option<f32>> {
    let pass = colour_pass(state, camera);
    let mut out = vec![None; state.model.gaussians.len()];
    for (splat, label) in pass.splats.iter().zip(cpu::backward_labels(&pass)) {
        out[splat.gaussian as usize] = Some((label.weight / weight_alone(splat, camera)).min(1.0));
    }
    out
}

/// Outward unit normals of all Gaussians, by the last measurement of visibility.
pub fn normals(state: &TrainState) -> Vec<[f32; 3]> {
    outward_normals(&source(state))
}

/// Share of each of `lights` that arrives at each of the Gaussians `members`, `[light][member]`, 0..=1. The number of lights is not limited.
pub fn light_shares(state: &TrainState, lights: &[SplitLight], members: &[u32]) -> Vec<Vec<f32>> {
    cpu::light_shares(&source(state), lights, members)
}

/// Exponent that approximates the display curve, for means of displayed colours.
const DISPLAY_EXPONENT: f32 = 1.0 / 2.2;

/// Irradiance of every Gaussian along its normal in `normals`: the sky through its visibility, plus the gathered light.
///
/// Where the light differs between photographs, it is the irradiance under which a matte surface would have the mean of its
/// displayed colours in the photographs.
pub fn irradiance(
    state: &TrainState,
    operators: &EnvOperators,
    lights: &PhotoLights,
    normals: &[[f32; 3]],
) -> Vec<[f32; 3]> {
    if let [light] = lights.blocks[..] {
        return irradiance_under(state, operators, PhotoLight { light, block: 0 }, normals);
    }
    let mut means = vec![[0.0f32; 3]; normals.len()];
    for (block, (light, share)) in lights.blocks.iter().zip(&lights.shares).enumerate() {
        let light = PhotoLight { light: *light, block };
        for (mean, e) in means.iter_mut().zip(irradiance_under(state, operators, light, normals)) {
            (0..3).for_each(|c| mean[c] += share * e[c].max(0.0).powf(DISPLAY_EXPONENT));
        }
    }
    means.into_iter().map(|mean| mean.map(|m| m.powf(1.0 / DISPLAY_EXPONENT))).collect()
}

fn irradiance_under(
    state: &TrainState,
    operators: &EnvOperators,
    light: PhotoLight,
    normals: &[[f32; 3]],
) -> Vec<[f32; 3]> {
    let tables = tables_of(&state.model, operators, light.light);
    let source = training::source(state, &NO_INDIRECT_BASIS, light);
    let of = |i: usize| -> [f32; 3] {
        let sky = sky_irradiance(&source, &tables, normals[i], i);
        let gathered = source.gathered.get(i).map_or([0.0; 6], |g| *g);
        std::array::from_fn(|c| sky[c] + gathered[c])
    };
    (0..state.model.gaussians.len()).map(of).collect()
}

/// Light that every Gaussian gathers from the model's other surfaces under the mean light of the photographs, without the shadows of
/// the sky: irradiance, mean blocked radiance. It is measured in `directions` directions over `bounces` rounds.
pub fn gathered_from_surfaces(
    state: &TrainState,
    operators: &EnvOperators,
    lights: &PhotoLights,
    directions: usize,
    bounces: usize,
) -> Vec<[f32; 6]> {
    let source = source(state);
    let probes = Probes::measure(&source, fibonacci_sphere(directions), ProbeSettings::of(source.options));
    let tables = mean_tables(state, operators, lights);
    Transport::new(&probes, outward_normals(&source)).gather(&source, &tables, bounces)
}

/// Tables of the mean light of the photographs: tables are linear in the light.
pub fn mean_tables(state: &TrainState, operators: &EnvOperators, lights: &PhotoLights) -> LightTables {
    operators.apply(&mean_radiance(&state.model, lights))
}

/// Radiance of each environment texel, the mean over the photographs.
fn mean_radiance(model: &Model, lights: &PhotoLights) -> Vec<[f32; 3]> {
    let turned = |light: &TurnedLight| {
        let radiance = environment_radiance(model, light.group);
        Cow::Owned(ColumnShift::new(light.radians, model.env_width).apply(&radiance).into_owned())
    };
    weighted_sum(lights.blocks.iter().map(turned), &lights.shares)
}

/// Gathered light, the mean over the photographs, `[Gaussian]`; empty where none was measured.
pub fn mean_gathered(state: &TrainState, lights: &PhotoLights) -> Vec<[f32; 6]> {
    let blocks = (0..lights.blocks.len()).map(|block| Cow::Borrowed(state.gathered_in(block)));
    weighted_sum(blocks, &lights.shares)
}

/// The sum of `weights[k]` times the `k`-th list, entry by entry.
fn weighted_sum<'a, const N: usize>(
    lists: impl Iterator<Item = Cow<'a, [[f32; N]]>>,
    weights: &[f32],
) -> Vec<[f32; N]> {
    let mut sum: Vec<[f32; N]> = Vec::new();
    for (list, weight) in lists.zip(weights) {
        sum.resize(sum.len().max(list.len()), [0.0; N]);
        for (sum, value) in sum.iter_mut().zip(list.iter()) {
            (0..N).for_each(|c| sum[c] += weight * value[c]);
        }
    }
    sum
}

/// Evidence of one photograph for a Gaussian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShownIn {
    /// Summed blending weight, pixels.
    pub weight: f32,
    /// Share of the footprint that other Gaussians do not hide, as in [`visible_shares`].
    pub share: f32,
    /// Mean of `values` over the pixels to which the Gaussian contributes, by its weight.
    pub mean: f32,
}

/// How the image of `camera` shows each Gaussian, with the means of `values`, one per row-major pixel. `None` for a Gaussian that no
/// pixel can show.
pub fn shown_in(state: &TrainState, camera: &Camera, values: &[f32]) -> Vec<Option<ShownIn>> {
    let pass = colour_pass(state, camera);
    let mut out = vec![None; state.model.gaussians.len()];
    for (splat, [sum, weight]) in pass.splats.iter().zip(cpu::weighted_sums(&pass, values)) {
        let mean = if weight > 0.0 { sum / weight } else { 0.0 };
        let share = (weight / weight_alone(splat, camera)).min(1.0);
        out[splat.gaussian as usize] = Some(ShownIn { weight, share, mean });
    }
    out
}

/// The summed weight that a splat would have without other splats, at most the number of pixels; half a pixel if its centre is outside
/// of the image.
fn weight_alone(splat: &Splat, camera: &Camera) -> f32 {
    let (width, height) = (camera.width as f32, camera.height as f32);
    let [a, b, c] = splat.covariance;
    let alone = std::f32::consts::TAU * splat.opacity * (a * c - b * b).max(0.0).sqrt();
    let [x, y] = splat.mean;
    let is_inside = (0.0..=width).contains(&x) && (0.0..=height).contains(&y);
    if is_inside { alone.clamp(f32::MIN_POSITIVE, width * height) } else { 0.5 }
}

fn colour_pass(state: &TrainState, camera: &Camera) -> Pass {
    let source = source(state);
    let view = RasterCamera::new(camera, source.options);
    Pass::forward(&source, view, Channels::Colour, EarlyStop::WhenSaturated)
}

fn mean_squared_error(image: &[[f32; 3]], photo: &Photo) -> f32 {
    let squares = image.iter().zip(&photo.pixels);
    let sum: f64 = squares.flat_map(|(a, b)| (0..3).map(move |c| f64::from(a[c] - b[c]).powi(2))).sum();
    (sum / (3 * photo.pixels.len()).max(1) as f64) as f32
}
