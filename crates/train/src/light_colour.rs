//! Estimates the colour of the light from the view dependence of the radiance branch.
//!
//! The radiance of a dielectric is its own colour times the light plus a highlight in the colour of the light
//! (dichromatic model, Shafer 1985). With the view, it changes within the plane of these two colours. The planes of
//! surfaces with different colours intersect in the colour of the light.

use glam::{DMat3, DVec3};

use relume_engine::{linear_from_srgb, sigmoid};
use relume_scene::light::LightColour;
use relume_scene::{DisplayRange, Field, Gaussians};

/// Y_00, and the factor of a direction's components in Y_1m.
const BANDS: [f32; 2] = [0.282_094_8, 0.488_602_5];
/// Display values of channels, over the white of the range for the upper one, that are neither near black nor near white, where
/// colours are distorted.
const LINEAR_RANGE: (f32, f32) = (0.04, 0.97);
/// Largest distance from the centre of the scene, in scene radii. Gaussians farther away are lit differently from the
/// object.
const SUBJECT_RADIUS: f32 = 1.0;
/// Coefficients of `ln(blue / red)` of the light: a constant, and factors on that of the intersection colour and on
/// that of the mean change. Both are biased towards warm colours, since blurred edges and wrong shapes mix surface
/// colours into the change. Fitted to 31 pairs of a scene and a light (docs/decisions/0009).
const BLUE_OVER_RED: [f32; 3] = [0.59, 0.66, 0.40];
/// Coefficients of `ln(green^2 / (red blue))`.
const GREEN: [f32; 3] = [-0.07, 0.80, 0.0];
/// Largest accepted magnitudes of the logarithms.
const MAX_LIGHT_COLOUR: LightColour = LightColour { blue_over_red: 1.5, green: 0.9 };
/// Least share of the object's weight that must have usable colours.
const MIN_WEIGHT_SHARE: f64 = 0.05;

/// The estimated colour of the light of photographs in `range`; neutral if the radiance branch has no view dependence.
pub fn estimate(g: &Gaussians, range: DisplayRange) -> LightColour {
    let (mut planes, mut change) = (DMat3::ZERO, DVec3::ZERO);
    let (mut told, mut all) = (0.0, 0.0);
    for i in 0..g.len() {
        let weight = weight(g, i);
        all += weight;
        let Some((body, by_view)) = colours(g, i, range) else { continue };
        told += weight;
        for v in by_view {
            let normal = body.cross(v);
            planes += DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z) * weight;
            change += v * v * weight;
        }
    }
    let change = DVec3::from_array(change.to_array().map(f64::sqrt));
    if !(told > MIN_WEIGHT_SHARE * all && change.min_element() > 1e-9) {
        return LightColour::NEUTRAL;
    }
    let of = |v: DVec3| LightColour::of(v.to_array().map(|c| c.max(1e-3 * v.max_element()) as f32));
    let (meeting, change) = (of(least_axis(planes)), of(change));
    let fit = |k: [f32; 3], a: f32, b: f32, most: f32| (k[0] + k[1] * a + k[2] * b).clamp(-most, most);
    LightColour {
        blue_over_red: fit(
            BLUE_OVER_RED,
            meeting.blue_over_red,
            change.blue_over_red,
            MAX_LIGHT_COLOUR.blue_over_red,
        ),
        green: fit(GREEN, meeting.green, change.green, MAX_LIGHT_COLOUR.green),
    }
}

/// Opacity times area of Gaussian `i`; 0 outside the object.
fn weight(g: &Gaussians, i: usize) -> f64 {
    let mean: [f32; 3] = g.get(Field::Mean, i);
    if mean.iter().map(|v| v * v).sum::<f32>() > SUBJECT_RADIUS * SUBJECT_RADIUS {
        return 0.0;
    }
    let s: [f32; 3] = g.get(Field::LogScale, i);
    let smallest = s.iter().fold(f32::INFINITY, |a, b| a.min(*b));
    f64::from(sigmoid(g.row(Field::OpacityLogit, i)[0]) * (s.iter().sum::<f32>() - smallest).exp())
}

/// Unit linear colour of Gaussian `i`, and the derivatives of its linear colour by the three components of the view
/// direction; `None` if they are unknown.
fn colours(g: &Gaussians, i: usize, range: DisplayRange) -> Option<(DVec3, [DVec3; 3])> {
    let radiance = g.row(Field::Radiance, i).as_chunks::<3>().0;
    let display: [f32; 3] = std::array::from_fn(|c| 0.5 + BANDS[0] * radiance[0][c]);
    let informative = LINEAR_RANGE.0..=LINEAR_RANGE.1 * range.white();
    if radiance.len() < 4 || !display.iter().all(|v| informative.contains(v)) {
        return None;
    }
    let linear = |at: [f32; 3]| DVec3::from_array(at.map(|v| f64::from(linear_from_srgb(v))));
    let slope = (linear(display.map(|v| v + 1e-3)) - linear(display.map(|v| v - 1e-3))) / 2e-3;
    let by_view = |k: usize| slope * DVec3::from_array(radiance[k].map(|v| f64::from(BANDS[1] * v)));
    Some((linear(display).normalize_or_zero(), [1, 2, 3].map(by_view)))
}

/// Unit eigenvector of the least eigenvalue of a positive semidefinite matrix, with a non-negative channel sum.
fn least_axis(matrix: DMat3) -> DVec3 {
    let size = matrix.x_axis.x + matrix.y_axis.y + matrix.z_axis.z;
    let inverse = (matrix + DMat3::IDENTITY * (1e-9 * size)).inverse();
    let mut axis = DVec3::ONE;
    for _ in 0..200 {
        axis = (inverse * axis).normalize_or(DVec3::ONE);
    }
    if axis.element_sum() < 0.0 { -axis } else { axis }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_engine::{fibonacci_sphere, srgb};

    fn estimate(g: &Gaussians) -> LightColour {
        super::estimate(g, DisplayRange::Unit)
    }

    /// Surfaces with the colours `bodies` in turn under `light`, each with a highlight in its own direction.
    fn scene(bodies: &[[f32; 3]], light: [f32; 3], highlight: f32) -> Gaussians {
        let sides = fibonacci_sphere(300);
        let mut g = Gaussians::zeroed(sides.len(), 1, 0, 1);
        for (i, side) in sides.iter().enumerate() {
            let body = bodies[i % bodies.len()];
            let radiance = g.row_mut(Field::Radiance, i);
            for c in 0..3 {
                let at = srgb(body[c] * light[c]);
                radiance[c] = (at - 0.5) / BANDS[0];
                let step = srgb(body[c] * light[c] + highlight * light[c]) - at;
                for (k, axis) in [1, 2, 0].into_iter().enumerate() {
                    radiance[3 * (k + 1) + c] = step * side[axis] / BANDS[1];
                }
            }
        }
        g
    }

    #[test]
    fn estimated_light_warmth_is_independent_of_surface_colours() {
        let bodies = [[0.5, 0.2, 0.1], [0.2, 0.4, 0.2], [0.15, 0.2, 0.5], [0.4, 0.4, 0.35]];
        let of = |bodies: &[[f32; 3]], light| estimate(&scene(bodies, light, 0.02)).blue_over_red;
        let lights = [[1.4, 0.9, 0.5], [1.0, 1.0, 1.0], [0.8, 0.95, 1.3]];
        let found = lights.map(|light| of(&bodies, light));
        assert!(found[0] + 0.5 < found[1] && found[1] + 0.2 < found[2], "{found:?}");
        // Warm surfaces under a neutral light are not mistaken for surfaces under a warm light.
        let warm = [[0.5, 0.3, 0.15], [0.4, 0.2, 0.1], [0.3, 0.25, 0.1]];
        let (warm, mixed) = (of(&warm, [1.0; 3]), of(&bodies, [1.0; 3]));
        assert!((warm - mixed).abs() < 0.15, "{warm} {mixed}");
    }

    #[test]
    fn light_is_neutral_without_view_dependent_colour() {
        assert_eq!(estimate(&scene(&[[0.5, 0.2, 0.1]], [1.4, 0.9, 0.5], 0.0)), LightColour::NEUTRAL);
        assert_eq!(estimate(&Gaussians::zeroed(0, 1, 0, 1)), LightColour::NEUTRAL);
        assert_eq!(estimate(&Gaussians::zeroed(5, 1, 0, 0)), LightColour::NEUTRAL, "no degree 1");
        let control = estimate(&scene(&[[0.5, 0.2, 0.1], [0.1, 0.2, 0.5]], [1.4, 0.9, 0.5], 0.02));
        assert!(control.blue_over_red < -0.3, "{control:?}");
    }

    #[test]
    fn surfaces_above_white_count_in_the_extended_range() {
        let bright = scene(&[[2.5, 1.0, 0.5], [0.5, 1.0, 2.5]], [1.4, 0.9, 0.5], 0.1);
        let found = super::estimate(&bright, DisplayRange::Extended);
        assert!(found.blue_over_red < -0.3, "{found:?}");
        assert_eq!(estimate(&bright), LightColour::NEUTRAL, "the control: clipped photographs");
    }
}
