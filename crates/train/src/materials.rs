//! Initial values and restarts of the materials: albedo from the colours of the radiance branch, with the shading
//! divided out.

use relume_engine::{PhotoLights, TrainState, evaluation, linear_from_srgb, sigmoid};
use relume_scene::light::{EnvOperators, LightColour, UPWARD_LUMINANCE};
use relume_scene::{DisplayRange, Field, Gaussians};

/// Iterations of k-means.
const ROUNDS: usize = 12;
/// Sharpness of the initial prototype scores, per squared linear colour distance. It is low because the colours
/// include the shading, and the light does not learn what albedo explains. It is above 0, otherwise the normals learn
/// the texture.
const FIRST_SHARPNESS: f32 = 2.0;
/// Sharpness at a restart, when the shading is divided out.
const SHARPNESS: f32 = 60.0;
/// Lower bound of the irradiance that divides a colour.
const MIN_IRRADIANCE: f32 = 0.3;
/// Range of an initial albedo.
const RANGE: (f32, f32) = (0.02, 0.95);
/// Initial metalness: most surfaces are dielectrics, and under a wrong light a highlight resembles metal.
const METALNESS: f32 = 0.03;
/// Initial roughness.
const ROUGHNESS: f32 = 0.5;

fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|c| (a[c] - b[c]).powi(2)).sum()
}

/// Linear view-independent colour of Gaussian `i` in the radiance branch of photographs in `range`.
pub fn colour(g: &Gaussians, i: usize, range: DisplayRange) -> [f32; 3] {
    let s = g.row(Field::Radiance, i);
    std::array::from_fn(|c| linear_from_srgb((0.5 + 0.282_094_8 * s[c]).clamp(0.0, range.white())))
}

/// The initial materials: albedo from the Gaussians' view-independent colours in `range`, under a light of colour `light`.
///
/// If the irradiance has the level of the exposure term, a diffuse surface's colour is its albedo times that level
/// and the light's colour.
pub fn initialise(state: &mut TrainState, light: LightColour, range: DisplayRange) {
    let g = &state.model.gaussians;
    let light = light.rgb().map(|c| UPWARD_LUMINANCE * c);
    let albedo = |i: usize| {
        let colour = colour(g, i, range);
        std::array::from_fn(|c| colour[c] / light[c])
    };
    let albedos: Vec<[f32; 3]> = (0..g.len()).map(albedo).collect();
    restart(state, &albedos, FIRST_SHARPNESS);
}

/// Restarts the materials from colours in `range` with the shading divided out: `albedo = colour pi / E`, where `E` is the
/// irradiance of each Gaussian through its visibility plus the gathered light, over the `lights` of the photographs.
/// `normals` are the outward normals of the measured visibility. Metalness and roughness, which a wrong light
/// distorts, restart from their initial values.
///
/// Light and albedo can explain the same shading, and gradient steps resolve this slowly. A restart acts like a step
/// of alternating least squares.
pub fn restart_albedo(
    state: &mut TrainState,
    operators: &EnvOperators,
    lights: &PhotoLights,
    normals: &[[f32; 3]],
    range: DisplayRange,
) {
    let irradiance = evaluation::irradiance(state, operators, lights, normals);
    let albedo = |(i, irradiance): (usize, &[f32; 3])| -> [f32; 3] {
        let colour = colour(&state.model.gaussians, i, range);
        std::array::from_fn(|c| colour[c] * std::f32::consts::PI / irradiance[c].max(MIN_IRRADIANCE))
    };
    let albedos: Vec<[f32; 3]> = irradiance.iter().enumerate().map(albedo).collect();
    restart(state, &albedos, SHARPNESS);
}

/// Sets metalness and roughness to their initial values.
pub fn reset_surface(g: &mut Gaussians) {
    for (field, start) in [(Field::MetalLogit, METALNESS), (Field::RoughLogit, ROUGHNESS)] {
        g.field_mut(field).fill((start / (1.0 - start)).ln());
    }
}

/// Sets the prototypes to the k-means centres of `albedos` minus their residuals, the scores by distance, metalness
/// and roughness to their initial values, and the moments to zero. Residuals stay: with few prototypes they contain
/// the texture.
fn restart(state: &mut TrainState, albedos: &[[f32; 3]], sharpness: f32) {
    let TrainState { model, moments, .. } = state;
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

/// K-means of weighted points: farthest-first initialisation, then Lloyd's iterations; deterministic.
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
    use relume_compare::{largest_difference, worst};
    use relume_engine::cpu::AttributeSource;
    use relume_engine::{fibonacci_sphere, srgb};
    use relume_scene::light::TableResolution;
    use relume_scene::{Model, ShadingOptions, VisibilityForm, softplus_inverse, texel_directions};
    use relume_spec::training::{Preset, TrainConfig};

    const DAYLIGHT_SKY: LightColour = LightColour { blue_over_red: 0.45, green: -0.13 };
    const COLOURS: [[f32; 3]; 2] = [[0.6, 0.2, 0.1], [0.2, 0.3, 0.5]];

    fn along(a: [f32; 3], b: [f32; 3]) -> f32 {
        (0..3).map(|k| a[k] * b[k]).sum()
    }

    /// A ball lit from above whose Gaussians alternate between two albedos, with the resulting radiance.
    fn shaded_ball() -> (TrainState, EnvOperators, Vec<[f32; 3]>) {
        ball_under([0.0, 0.0, 0.8], &[0.0])
    }

    /// As [`shaded_ball`], under a sky of 1 + slope . d that is rotated by each of `rotations`, radians.
    fn ball_under(slope: [f32; 3], rotations: &[f64]) -> (TrainState, EnvOperators, Vec<[f32; 3]>) {
        let config = TrainConfig::preset(Preset::Draft);
        let normals = fibonacci_sphere(200);
        let (rows, columns) = (8, 16);
        let sky = texel_directions(columns, rows)
            .into_iter()
            .map(|(d, _)| [softplus_inverse(1.0 + along(slope, d.as_vec3().to_array())); 3]);
        let shading = ShadingOptions { visibility: VisibilityForm::Off, ..config.shading };
        let mut model = Model {
            shading,
            ..Model::new(
                Gaussians::zeroed(normals.len(), 2, 0, 0),
                vec![[0.5; 3]; 2],
                sky.collect(),
                (columns, rows),
            )
        };
        for (i, n) in normals.iter().enumerate() {
            // E = pi (1 + 2/3 slope . n) under a sky of 1 + slope . d.
            let light = |turn: &f64| {
                let (sin, cos) = (*turn as f32).sin_cos();
                let slope = [cos * slope[0] - sin * slope[1], sin * slope[0] + cos * slope[1], slope[2]];
                1.0 + 2.0 / 3.0 * along(slope, *n)
            };
            let radiance = model.gaussians.row_mut(Field::Radiance, i);
            for (r, albedo) in radiance.iter_mut().zip(COLOURS[i % 2]) {
                let shown = rotations.iter().map(|turn| srgb(albedo * light(turn))).sum::<f32>();
                *r = (shown / rotations.len() as f32 - 0.5) / 0.282_094_8;
            }
        }
        (TrainState::new(model), EnvOperators::new(columns, rows, 0, TableResolution::TRAINING), normals)
    }

    /// Largest error of any Gaussian's albedo.
    fn albedo_error(state: &TrainState) -> f64 {
        let Model { gaussians, prototypes, shading, .. } = &state.model;
        let source = AttributeSource::new(gaussians, prototypes, shading);
        worst((0..gaussians.len()).map(|i| largest_difference(&source.albedo(i), &COLOURS[i % 2])))
    }

    #[test]
    fn albedo_restart_removes_shading_from_albedo() {
        let (mut state, operators, normals) = shaded_ball();
        initialise(&mut state, DAYLIGHT_SKY, DisplayRange::Unit);
        let control = albedo_error(&state);
        assert!(control.is_finite() && control > 0.1, "the control: colours with their shading, {control}");
        state.model.gaussians.field_mut(Field::Residual).fill(0.05);
        state.moments.second.field_mut(Field::ProtoLogits).fill(1.0);
        restart_albedo(&mut state, &operators, &PhotoLights::default(), &normals, DisplayRange::Unit);
        assert!(albedo_error(&state) < 0.01, "{}", albedo_error(&state));
        assert!(state.moments.second.field(Field::ProtoLogits).iter().all(|m| *m == 0.0));
    }

    #[test]
    fn albedo_restart_removes_shading_of_a_rotating_light() {
        let degrees = [0.0, 90.0];
        let radians = degrees.map(f64::to_radians);
        let (mut state, operators, normals) = ball_under([0.9, 0.0, 0.0], &radians);
        restart_albedo(
            &mut state,
            &operators,
            &PhotoLights::of(&degrees.map(|d| (0, d))).0,
            &normals,
            DisplayRange::Unit,
        );
        assert!(albedo_error(&state) < 0.015, "{}", albedo_error(&state));
        restart_albedo(&mut state, &operators, &PhotoLights::default(), &normals, DisplayRange::Unit);
        let control = albedo_error(&state);
        assert!(control.is_finite() && control > 0.02, "the control: rotations ignored, {control}");
    }

    #[test]
    fn grey_object_under_daylight_is_initialised_grey() {
        let (mut state, ..) = shaded_ball();
        for radiance in state.model.gaussians.field_mut(Field::Radiance).chunks_mut(3) {
            for (r, light) in radiance.iter_mut().zip(DAYLIGHT_SKY.rgb()) {
                *r = (srgb(0.5 * UPWARD_LUMINANCE * light) - 0.5) / 0.282_094_8;
            }
        }
        initialise(&mut state, DAYLIGHT_SKY, DisplayRange::Unit);
        assert!(state.model.prototypes.iter().flatten().all(|v| (v - 0.5).abs() < 1e-3));
    }

    #[test]
    fn metalness_and_roughness_restart_with_albedo() {
        let (mut state, operators, normals) = shaded_ball();
        for field in [Field::MetalLogit, Field::RoughLogit] {
            state.model.gaussians.field_mut(field).fill(4.0);
            state.moments.first.field_mut(field).fill(1.0);
        }
        restart_albedo(&mut state, &operators, &PhotoLights::default(), &normals, DisplayRange::Unit);
        for (field, start) in [(Field::MetalLogit, METALNESS), (Field::RoughLogit, ROUGHNESS)] {
            let values = state.model.gaussians.field(field);
            assert!(values.iter().all(|v| (sigmoid(*v) - start).abs() < 1e-6), "{field:?}: {}", values[0]);
            assert!(state.moments.first.field(field).iter().all(|m| *m == 0.0));
        }
    }

    #[test]
    fn albedo_restart_stays_in_range_under_a_black_sky() {
        let (mut state, operators, normals) = shaded_ball();
        state.model.env_raw.fill([softplus_inverse(1e-6); 3]);
        state.model.gaussians.field_mut(Field::Radiance).fill(10.0);
        restart_albedo(&mut state, &operators, &PhotoLights::default(), &normals, DisplayRange::Unit);
        assert!(state.model.prototypes.iter().flatten().all(|v| (RANGE.0..=RANGE.1).contains(v)));
        assert!(state.model.check().is_ok());
    }
}
