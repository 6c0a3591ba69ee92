//! Samples of the lobe of directions that a rough surface reflects, and their places in an equirectangular map.

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use glam::{DVec3, Vec3};
use multiversion::multiversion;

use crate::light::{SPECULAR_LEVELS, brdf::ggx_d};

/// Samples of each specular level. The narrowest lobe covers few texels, and has most nodes.
const SAMPLES: [u32; SPECULAR_LEVELS.len()] = [96, 192, 192, 192, 192, 192];

/// One sample of the lobe around +Z: direction, weight, solid angle.
struct LobeDirection {
    direction: DVec3,
    weight: f64,
    solid_angle: f64,
}

/// Samples of `D(half) cos` with N = V = R, weights summing to 1.
fn lobe_samples(alpha: f64, samples: u32) -> Vec<LobeDirection> {
    let mut out: Vec<LobeDirection> = (0..samples)
        .filter_map(|i| {
            let u1 = (f64::from(i) + 0.5) / f64::from(samples);
            let u2 = (f64::from(i.reverse_bits()) + 0.5) / 4_294_967_296.0;
            let cos_h = ((1.0 - u2) / (1.0 + (alpha * alpha - 1.0) * u2)).sqrt();
            let sin_h = (1.0 - cos_h * cos_h).max(0.0).sqrt();
            let phi = std::f64::consts::TAU * u1;
            let h = DVec3::new(sin_h * phi.cos(), sin_h * phi.sin(), cos_h);
            let direction = 2.0 * cos_h * h - DVec3::Z;
            // The density of the reflected direction is D(h) cos_h / (4 cos_h).
            let density = 0.25 * ggx_d(cos_h, alpha);
            let solid_angle = 1.0 / (f64::from(samples) * density.max(1e-12));
            (direction.z > 0.0).then_some(LobeDirection { direction, weight: direction.z, solid_angle })
        })
        .collect();
    let total: f64 = out.iter().map(|s| s.weight).sum();
    out.iter_mut().for_each(|s| s.weight /= total);
    out
}

/// How a sample of a lobe reads a pyramid of maps: between level `low` and the next coarser one.
pub(super) struct Tap {
    pub(super) weight: f32,
    pub(super) low: usize,
    pub(super) fraction: f32,
}

/// The samples of the lobe of a specular level, for a pyramid of maps.
pub(super) struct ReflectionLobe {
    /// X, y and z of the directions around +Z.
    directions: [Vec<f32>; 3],
    pub(super) taps: Vec<Tap>,
}

/// Columns and rows of the samples of a lobe in a map, both from 0 to 1.
#[derive(Default)]
pub(super) struct Places {
    pub(super) u: Vec<f32>,
    pub(super) v: Vec<f32>,
}

impl ReflectionLobe {
    /// The lobe of specular level `k`, with its positions in a pyramid of maps of these sizes.
    pub(super) fn new(k: usize, sizes: &[(usize, usize)]) -> Self {
        let alpha = f64::from(SPECULAR_LEVELS[k]).powi(2);
        let texel = 4.0 * std::f64::consts::PI / (sizes[0].0 * sizes[0].1) as f64;
        let tap = |s: &LobeDirection| {
            // One level coarser than the sample's footprint, so that neighbouring samples overlap.
            let level = (0.5 * (s.solid_angle / texel).log2() + 1.0).clamp(0.0, (sizes.len() - 1) as f64);
            Tap { weight: s.weight as f32, low: level as usize, fraction: level.fract() as f32 }
        };
        let samples = lobe_samples(alpha, SAMPLES[k]);
        let axis = |c: usize| samples.iter().map(|s| s.direction[c] as f32).collect();
        Self { directions: [0, 1, 2].map(axis), taps: samples.iter().map(tap).collect() }
    }

    /// The places of the samples of the lobe around `r`.
    pub(super) fn places_around(&self, r: DVec3, places: &mut Places) {
        let r = r.as_vec3();
        let (across, along) = r.any_orthonormal_pair();
        places.u.resize(self.taps.len(), 0.0);
        places.v.resize(self.taps.len(), 0.0);
        let [x, y, z] = &self.directions;
        write_places([x, y, z], [across, along, r], &mut places.u, &mut places.v);
    }
}

/// The places in an equirectangular map of directions whose components belong to `axes`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
fn write_places([x, y, z]: [&[f32]; 3], axes: [Vec3; 3], u: &mut [f32], v: &mut [f32]) {
    let [across, along, up] = axes;
    for ((((x, y), z), u), v) in x.iter().zip(y).zip(z).zip(u).zip(v) {
        let d = [0, 1, 2].map(|c| x * across[c] + y * along[c] + z * up[c]);
        *u = 0.5 - atan2(d[1], d[0]) / TAU;
        *v = atan2((d[0] * d[0] + d[1] * d[1]).sqrt(), d[2]) / PI;
    }
}

/// The angle of a point of the plane, radians, within 1e-6: M. Abramowitz and I. A. Stegun, "Handbook of Mathematical Functions", 1964,
/// 4.4.49. Without branches, so that loops use vectors.
#[inline(always)]
fn atan2(y: f32, x: f32) -> f32 {
    const C: [f32; 8] = [
        -0.333_331_45,
        0.199_935_5,
        -0.142_089,
        0.106_562_64,
        -0.075_289_64,
        0.042_909_614,
        -0.016_165_737,
        0.002_866_225_7,
    ];
    let (ax, ay) = (x.abs(), y.abs());
    let (small, large) = if ay > ax { (ax, ay) } else { (ay, ax) };
    let t = small / large.max(f32::MIN_POSITIVE);
    let s = t * t;
    let mut sum = C[7];
    for c in C[..7].iter().rev() {
        sum = sum * s + c;
    }
    let angle = t + t * s * sum;
    let angle = if ay > ax { FRAC_PI_2 - angle } else { angle };
    let angle = if x < 0.0 { PI - angle } else { angle };
    angle.copysign(y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_compare::worst;

    #[test]
    fn angles_are_those_of_the_standard_library() {
        let error = |turn: f32| {
            let angles = (-3141..=3141).map(|i| i as f32 * 1e-3);
            worst(angles.map(|a| {
                let (y, x) = a.sin_cos();
                f64::from((atan2(3.0 * y, 3.0 * x) - (y.atan2(x) + turn)).abs())
            }))
        };
        assert!(error(0.0) < 1e-6, "{}", error(0.0));
        assert!(error(1e-4) > 1e-5, "the control");
        assert_eq!([atan2(0.0, 0.0), atan2(0.0, 1.0), atan2(2.0, 0.0)], [0.0, 0.0, FRAC_PI_2]);
    }

    #[test]
    fn places_are_those_of_the_mapping_of_environments() {
        let lobe = ReflectionLobe::new(2, &[(256, 128)]);
        let error = |turn: f64| {
            worst(crate::texel_directions(12, 6).into_iter().map(|(r, _)| {
                let mut places = Places::default();
                lobe.places_around(r, &mut places);
                let (across, along) = r.as_vec3().any_orthonormal_pair();
                let apart = (0..lobe.taps.len()).map(|i| {
                    let [x, y, z] = [0, 1, 2].map(|c| f64::from(lobe.directions[c][i]));
                    let d = x * across.as_dvec3() + y * along.as_dvec3() + z * r;
                    let [u, v] = crate::direction_to_uv(d);
                    // Columns are undefined at the poles.
                    let column = (f64::from(places.u[i]) - u + turn).abs() * (1.0 - d.z * d.z).sqrt();
                    column.min(1.0 - column).max((f64::from(places.v[i]) - v).abs())
                });
                worst(apart)
            }))
        };
        assert!(error(0.0) < 1e-5, "{}", error(0.0));
        assert!(error(1e-3) > 1e-4, "the control");
    }
}
