//! Where albedo starts from: the colours that the radiance branch found, with as much light taken out as is known.

use crate::engine::cpu::{linear_from_srgb, sigmoid, sky_irradiance};
use crate::engine::indirect_basis;
use crate::light::{DAYLIGHT, EnvOperators};
use crate::scene::{Field, Gaussians};
use crate::train::state::Learned;
use crate::train::step;

/// Rounds of k-means.
const ROUNDS: usize = 12;
/// Sharpness of the very first scores, per squared linear colour distance: vague, since the colours have the light in
/// them, and what albedo explains the light will not learn. Flat ones (0) left texture to the normals.
const FIRST_SHARPNESS: f32 = 2.0;
/// The same once the light has been divided out.
const SHARPNESS: f32 = 60.0;
/// Least irradiance that a colour is divided by.
const LEAST_IRRADIANCE: f32 = 0.3;
/// Range of a first albedo.
const RANGE: (f32, f32) = (0.02, 0.95);
/// First metalness: most surfaces are dielectrics, and a metal is what a wrong light makes of a highlight.
const METALNESS: f32 = 0.03;
/// First roughness.
const ROUGHNESS: f32 = 0.5;

fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|c| (a[c] - b[c]).powi(2)).sum()
}

/// Linear view-independent colour of Gaussian `i` in the radiance branch.
fn colour(g: &Gaussians, i: usize) -> [f32; 3] {
    let s = g.row(Field::Radiance, i);
    std::array::from_fn(|c| linear_from_srgb((0.5 + 0.282_094_8 * s[c]).clamp(0.0, 1.0)))
}

/// The very first materials: albedo from the Gaussians' view-independent colours, under daylight.
///
/// Under a light of irradiance pi (see the exposure term) a diffuse surface's colour is its albedo times the light's.
pub fn initialise(learned: &mut Learned) {
    let g = &learned.model.gaussians;
    let albedo = |i: usize| {
        let colour = colour(g, i);
        std::array::from_fn(|c| colour[c] / DAYLIGHT[c])
    };
    let albedos: Vec<[f32; 3]> = (0..g.len()).map(albedo).collect();
    restart(learned, &albedos, FIRST_SHARPNESS);
}

/// Materials anew from colours with the light divided out: `albedo = colour pi / E`, `E` the irradiance of each
/// Gaussian through its visibility with what is gathered. `normals` are the outward ones of the measured visibility.
/// Metalness and roughness, which a wrong light has led astray, start anew with them.
///
/// Light and albedo trade shading for one another, and gradient steps move along that valley slowly; this walks it in
/// strides, as alternating least squares would.
pub fn take_light_out(learned: &mut Learned, operators: &EnvOperators, normals: &[[f32; 3]]) {
    let model = &learned.model;
    let tables = operators.apply(&step::radiance_of(model));
    let basis = indirect_basis(&tables);
    let source = step::source(learned, &basis);
    let albedo = |i: usize| -> [f32; 3] {
        let (colour, sky) = (colour(&model.gaussians, i), sky_irradiance(&source, &tables, normals[i], i));
        let bounced = learned.gathered.get(i).map_or([0.0; 6], |g| *g);
        std::array::from_fn(|c| {
            colour[c] * std::f32::consts::PI / (sky[c] + bounced[c]).max(LEAST_IRRADIANCE)
        })
    };
    let albedos: Vec<[f32; 3]> = (0..model.gaussians.len()).map(albedo).collect();
    restart(learned, &albedos, SHARPNESS);
}

/// A dielectric of middling roughness everywhere.
pub fn reset_surface(g: &mut Gaussians) {
    for (field, start) in [(Field::MetalLogit, METALNESS), (Field::RoughLogit, ROUGHNESS)] {
        g.field_mut(field).fill((start / (1.0 - start)).ln());
    }
}

/// Prototypes at the k-means centres of `albedos` less their residuals, scores by distance, metalness and roughness as
/// at the start, and no memory of earlier steps. Residuals stay: where there are few prototypes they are the texture.
fn restart(learned: &mut Learned, albedos: &[[f32; 3]], sharpness: f32) {
    let Learned { model, moments, .. } = learned;
    let opacity = |i: usize| sigmoid(model.gaussians.row(Field::OpacityLogit, i)[0]);
    let point = |(i, albedo): (usize, &[f32; 3])| {
        let residual = model.gaussians.row(Field::Residual, i);
        let rest = |c: usize| (albedo[c].clamp(RANGE.0, RANGE.1) - residual[c]).clamp(RANGE.0, RANGE.1);
        (std::array::from_fn(rest), opacity(i))
    };
    let points: Vec<([f32; 3], f32)> = albedos.iter().enumerate().map(point).collect();
    if points.is_empty() {
        return;
    }
    let centres = k_means(&points, model.prototypes.len());
    for (i, (albedo, _)) in points.iter().enumerate() {
        let scores = model.gaussians.row_mut(Field::ProtoLogits, i);
        for (score, centre) in scores.iter_mut().zip(&centres) {
            *score = -sharpness * distance(*albedo, *centre);
        }
    }
    reset_surface(&mut model.gaussians);
    for moments in [&mut moments.first, &mut moments.second] {
        for field in [Field::ProtoLogits, Field::MetalLogit, Field::RoughLogit] {
            moments.field_mut(field).fill(0.0);
        }
    }
    moments.globals.iter_mut().for_each(|moments| moments[..centres.len()].fill([0.0; 3]));
    model.prototypes = centres;
}

/// Farthest-first start, then Lloyd's rounds: no random draw.
fn k_means(points: &[([f32; 3], f32)], k: usize) -> Vec<[f32; 3]> {
    let mut centres = vec![points[0].0];
    let mut nearest: Vec<f32> = points.iter().map(|(p, _)| distance(*p, centres[0])).collect();
    while centres.len() < k {
        let score = |i: &usize| nearest[*i] * points[*i].1;
        let next = (0..points.len()).max_by(|a, b| score(a).total_cmp(&score(b))).unwrap_or(0);
        centres.push(points[next].0);
        for (n, (p, _)) in nearest.iter_mut().zip(points) {
            *n = n.min(distance(*p, points[next].0));
        }
    }
    for _ in 0..ROUNDS {
        let mut sums = vec![([0.0f64; 3], 0.0f64); k];
        for (p, w) in points {
            let best = (0..k).min_by(|a, b| distance(*p, centres[*a]).total_cmp(&distance(*p, centres[*b])));
            let (sum, weight) = &mut sums[best.unwrap_or(0)];
            (0..3).for_each(|c| sum[c] += f64::from(p[c] * w));
            *weight += f64::from(*w);
        }
        for (centre, (sum, weight)) in centres.iter_mut().zip(sums) {
            if weight > 0.0 {
                *centre = sum.map(|s| (s / weight) as f32);
            }
        }
    }
    centres
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::cpu::{AttributeSource, srgb};
    use crate::engine::fibonacci_sphere;
    use crate::light::TableResolution;
    use crate::scene::{Model, ShadingOptions, VisibilityForm, softplus_inverse, texel_directions};
    use crate::train::{Preset, TrainConfig};

    const COLOURS: [[f32; 3]; 2] = [[0.6, 0.2, 0.1], [0.2, 0.3, 0.5]];

    /// A ball whose Gaussians have one of two albedos in turn, lit from above, and the radiance that follows.
    fn lit_ball() -> (Learned, EnvOperators, Vec<[f32; 3]>) {
        let config = TrainConfig::preset(Preset::Draft);
        let normals = fibonacci_sphere(200);
        let (rows, columns) = (8, 16);
        let sky = texel_directions(columns, rows)
            .into_iter()
            .map(|(d, _)| [softplus_inverse(1.0 + 0.8 * d[2] as f32); 3]);
        let shading = ShadingOptions { visibility: VisibilityForm::Off, ..config.shading };
        let mut model = Model {
            gaussians: Gaussians::zeroed(normals.len(), 2, 0, 0),
            prototypes: vec![[0.5; 3]; 2],
            env_raw: sky.collect(),
            env_width: columns,
            env_height: rows,
            shading,
            world_scale: 1.0,
            world_offset: Default::default(),
            card: serde_json::Value::Null,
        };
        for (i, n) in normals.iter().enumerate() {
            // E = pi (1 + 2/3 x 0.8 n_z) under a sky of 1 + 0.8 z.
            let light = 1.0 + 0.8 * 2.0 / 3.0 * n[2];
            let radiance = model.gaussians.row_mut(Field::Radiance, i);
            for (r, albedo) in radiance.iter_mut().zip(COLOURS[i % 2]) {
                *r = (srgb(albedo * light) - 0.5) / 0.282_094_8;
            }
        }
        (Learned::new(model), EnvOperators::new(columns, rows, 0, TableResolution::TRAINING), normals)
    }

    /// Worst difference of any Gaussian's albedo from the truth.
    fn worst(learned: &Learned) -> f32 {
        let Model { gaussians, prototypes, shading, .. } = &learned.model;
        let source = AttributeSource {
            gaussians,
            prototypes,
            options: shading,
            gathered: &[],
            indirect_basis: &[[0.0; 3]; 16],
            light: None,
        };
        let error = |i: usize| (0..3).map(move |c| (source.albedo(i)[c] - COLOURS[i % 2][c]).abs());
        (0..gaussians.len()).flat_map(error).fold(0.0, f32::max)
    }

    #[test]
    fn what_the_light_did_to_the_colours_is_not_in_the_albedo() {
        let (mut learned, operators, normals) = lit_ball();
        initialise(&mut learned);
        assert!(worst(&learned) > 0.1, "the control: colours as they are, {}", worst(&learned));
        learned.model.gaussians.field_mut(Field::Residual).fill(0.05);
        learned.moments.second.field_mut(Field::ProtoLogits).fill(1.0);
        take_light_out(&mut learned, &operators, &normals);
        assert!(worst(&learned) < 0.01, "{}", worst(&learned));
        assert!(learned.moments.second.field(Field::ProtoLogits).iter().all(|m| *m == 0.0));
    }

    #[test]
    fn under_daylight_a_grey_thing_starts_grey() {
        let (mut learned, ..) = lit_ball();
        for radiance in learned.model.gaussians.field_mut(Field::Radiance).chunks_mut(3) {
            for (r, light) in radiance.iter_mut().zip(DAYLIGHT) {
                *r = (srgb(0.5 * light) - 0.5) / 0.282_094_8;
            }
        }
        initialise(&mut learned);
        assert!(learned.model.prototypes.iter().flatten().all(|v| (v - 0.5).abs() < 1e-3));
    }

    #[test]
    fn metalness_and_roughness_start_anew_with_albedo() {
        let (mut learned, operators, normals) = lit_ball();
        for field in [Field::MetalLogit, Field::RoughLogit] {
            learned.model.gaussians.field_mut(field).fill(4.0);
            learned.moments.first.field_mut(field).fill(1.0);
        }
        take_light_out(&mut learned, &operators, &normals);
        for (field, start) in [(Field::MetalLogit, METALNESS), (Field::RoughLogit, ROUGHNESS)] {
            let values = learned.model.gaussians.field(field);
            assert!(values.iter().all(|v| (sigmoid(*v) - start).abs() < 1e-6), "{field:?}: {}", values[0]);
            assert!(learned.moments.first.field(field).iter().all(|m| *m == 0.0));
        }
    }

    #[test]
    fn a_black_sky_and_a_white_colour_leave_albedo_in_its_range() {
        let (mut learned, operators, normals) = lit_ball();
        learned.model.env_raw.fill([softplus_inverse(1e-6); 3]);
        learned.model.gaussians.field_mut(Field::Radiance).fill(10.0);
        take_light_out(&mut learned, &operators, &normals);
        assert!(learned.model.prototypes.iter().flatten().all(|v| (RANGE.0..=RANGE.1).contains(v)));
        assert!(learned.model.check().is_ok());
    }
}
