//! Lamps of a request in the normalised world of a model, and frames under them.

use std::f64::consts::PI;

use glam::DVec3;

use crate::render::{Frame, Renderer};
use relume_engine::{Lamp as EngineLamp, LampCone, LampFrame, LampShadows, RasterCamera};
use relume_scene::light::{disc_points, fibonacci_directions};
use relume_scene::{Model, Output};
use relume_spec::rendering::{Lamp, LampShape, Tier};

/// Points of the surface of a lamp that is no point.
const POINTS: usize = 24;
/// Greatest intensity, with which the radiance of surfaces at any distance is finite.
const MAX_INTENSITY: f64 = 1e20;
/// Share of the half angle of a cone up to which the light is full.
const FULL_SHARE: f64 = 0.8;

impl Renderer {
    /// The frame of `view` under `lamps` alone. The tiers with rays trace its shadows in each pixel.
    pub(super) fn lamp_frame(&self, view: RasterCamera, lamps: &[Lamp], tier: Tier) -> LampFrame<'_> {
        let shadows = match tier {
            Tier::Preview | Tier::Standard => LampShadows::AtGaussians,
            Tier::High | Tier::MonteCarlo => LampShadows::InPixels,
        };
        let lamps = lamps.iter().map(|lamp| normalised(lamp, self.model())).collect();
        self.host().lamp_frame(view, lamps, shadows)
    }
}

/// Adds the light of lamps to the colours under the environment in `frame`, from row-major pixel `first` on.
pub(super) fn add_lamps(frame: &mut Frame, first: usize, [diffuse, specular]: &[Vec<f32>; 2]) {
    for (output, parts) in [
        (Output::Rgb, &[diffuse, specular][..]),
        (Output::Diffuse, &[diffuse]),
        (Output::Specular, &[specular]),
    ] {
        let Some(plane) = frame.planes.get_mut(&output) else { continue };
        for part in parts {
            plane[3 * first..]
                .iter_mut()
                .zip(*part)
                .for_each(|(value, added)| *value = (*value + added).min(f32::MAX));
        }
    }
}

/// A lamp in the normalised world of `model`.
pub(super) fn normalised(lamp: &Lamp, model: &Model) -> EngineLamp {
    let scale = model.world_scale;
    let place = |p: [f64; 3]| (DVec3::from_array(p) + model.world_offset) * scale;
    let centre = place(lamp.position);
    let axis = lamp.target.map(|target| (place(target) - centre).normalize_or(DVec3::NEG_Z));
    let radius = lamp.radius.unwrap_or(0.0) * scale;
    let size = lamp.size.unwrap_or_default().map(|side| side * scale);
    let is_flat = matches!(lamp.shape, LampShape::Disc | LampShape::Rectangle);
    let offsets = match (lamp.shape, axis) {
        (LampShape::Rectangle, Some(axis)) => rectangle(axis, size),
        (LampShape::Disc, Some(axis)) if radius > 0.0 => disc(axis, radius),
        _ if radius > 0.0 => sphere(radius),
        _ => vec![DVec3::ZERO],
    };
    let vector = |v: DVec3| v.to_array().map(|v| v as f32);
    let half = lamp.half_cone();
    let cone = |axis: DVec3| LampCone {
        axis: vector(axis),
        outer: half.cos() as f32,
        inner: (FULL_SHARE * half).cos() as f32,
    };
    let points: Vec<_> = offsets.into_iter().map(|offset| vector(centre + offset)).collect();
    // Radius of a disc of the area of the lamp.
    let of_area = match lamp.shape {
        LampShape::Rectangle => (size[0] * size[1] / PI).sqrt(),
        _ => radius,
    };
    EngineLamp {
        normal: axis.filter(|_| is_flat).map(vector),
        cone: axis.filter(|_| lamp.shape == LampShape::Spot).map(cone),
        intensity: lamp.radiant_intensity().map(|v| (v * scale * scale).min(MAX_INTENSITY) as f32),
        radius: (of_area / (points.len() as f64).sqrt()) as f32,
        points,
    }
}

/// Points spread evenly over a sphere.
fn sphere(radius: f64) -> Vec<DVec3> {
    fibonacci_directions(POINTS).into_iter().map(|d| radius * d).collect()
}

/// Points spread evenly over a disc that is perpendicular to `axis`.
fn disc(axis: DVec3, radius: f64) -> Vec<DVec3> {
    let (u, v) = axis.any_orthonormal_pair();
    disc_points(POINTS).map(|[x, y]| radius * (x * u + y * v)).collect()
}

/// Points on a grid over a rectangle that is perpendicular to `axis`, whose width is horizontal.
fn rectangle(axis: DVec3, [width, height]: [f64; 2]) -> Vec<DVec3> {
    let across = axis.cross(DVec3::Z).try_normalize().unwrap_or(DVec3::X);
    let up = across.cross(axis);
    let columns = ((POINTS as f64 * width / height).sqrt().round() as usize).clamp(1, POINTS);
    let rows = ((POINTS as f64 / columns as f64).round() as usize).max(1);
    let at = |k: usize, count: usize| (k as f64 + 0.5) / count as f64 - 0.5;
    let point =
        |i: usize| across * (width * at(i % columns, columns)) + up * (height * at(i / columns, rows));
    (0..columns * rows).map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_flat_lamps_lie_in_their_shape() {
        let axis = DVec3::new(0.6, 0.0, -0.8);
        for points in [rectangle(axis, [2.0, 0.5]), rectangle(axis, [0.01, 9.0]), disc(axis, 1.0)] {
            let mean = points.iter().sum::<DVec3>() / points.len() as f64;
            assert!(mean.length() < 0.05, "{mean}");
            assert!(points.iter().all(|p| p.dot(axis).abs() < 1e-9 && p.length() < 4.6));
        }
        let points = rectangle(axis, [2.0, 0.5]);
        assert!(
            points.iter().any(|p| p.y.abs() > 0.8) && points.iter().all(|p| p.y.abs() < 1.0),
            "the width is horizontal"
        );
        assert!(sphere(0.5).iter().all(|p| (p.length() - 0.5).abs() < 1e-9));
    }
}
