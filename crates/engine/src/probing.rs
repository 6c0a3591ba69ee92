//! Transmittance probes of both engines: their directions, and their clearance from their own surface (docs/MODEL.md,
//! section 6).

use glam::Vec3;

use relume_scene::light::fibonacci_directions;
use relume_scene::{ShadingOptions, SplitLight};

/// `n` directions spread evenly over the sphere (Fibonacci spiral).
pub fn fibonacci_sphere(n: usize) -> Vec<[f32; 3]> {
    fibonacci_directions(n).into_iter().map(|d| d.to_array().map(|v| v as f32)).collect()
}

/// Angular radius up to which a light counts as a point, radians.
const POINT: f32 = 0.5 * std::f32::consts::PI / 180.0;

/// Directions over which the transmittance towards a light is averaged: its centre and, for a light that is not a point, six
/// directions of its disc around it. Their mean square distance from the centre is that of the disc.
pub fn towards_light(light: &SplitLight) -> Vec<[f32; 3]> {
    let centre = light.direction;
    if !(light.radius > POINT) {
        return vec![centre];
    }
    let [z, x, y] = {
        let z = Vec3::from(centre);
        let (x, y) = z.any_orthonormal_pair();
        [z, x, y]
    };
    let ring = light.radius.min(1.0) * (7.0f32 / 12.0).sqrt();
    let around = (0..6).map(|k| {
        let (sin, cos) = (k as f32 * std::f32::consts::FRAC_PI_3).sin_cos();
        (z + ring.tan() * (cos * x + sin * y)).normalize().to_array()
    });
    std::iter::once(centre).chain(around).collect()
}

/// Start point of a query and distances at which occluders count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProbeSettings {
    /// Offset of the start along the outward normal, standard deviations.
    pub offset: f32,
    /// Additional offset of the start along the outward normal, world units.
    pub lift: f32,
    /// Smallest distance of an occluder along the direction, in its own standard deviations.
    pub clearance: f32,
    /// Addend to that distance, world units.
    pub bias: f32,
    /// Largest distance of an occluder, world units.
    pub reach: f32,
}

impl ProbeSettings {
    /// The settings with which a model is trained and rendered.
    pub fn of(options: &ShadingOptions) -> Self {
        Self { reach: options.occluder_reach.unwrap_or(f32::INFINITY), ..Self::default() }
    }
}

impl Default for ProbeSettings {
    fn default() -> Self {
        Self { offset: 1.0, lift: 0.0, clearance: 2.0, bias: 0.03, reach: f32::INFINITY }
    }
}
