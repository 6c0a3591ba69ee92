//! The surface model of the synthetic scene and its direction sampling.
//!
//! Lambert `a (1 - m) / pi` plus Cook-Torrance with the GGX distribution (`alpha = roughness^2`), the
//! height-correlated Smith shadowing term and Schlick's Fresnel with `F0 = 0.04 (1 - m) + a m`.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};

use super::scene::Material;
use relume_scene::{EnvMap, direction_to_uv, texel_directions};

/// A surface point and the direction from which it is seen.
pub(super) struct SurfacePoint {
    pub normal: DVec3,
    pub view: DVec3,
    pub material: Material,
}

impl SurfacePoint {
    /// BRDF times cosine for light from unit direction `l`, per channel; zero for light from below.
    pub(super) fn reflect(&self, l: DVec3) -> DVec3 {
        let (n_l, n_v) = (self.normal.dot(l), self.normal.dot(self.view).max(1e-6));
        if n_l <= 0.0 {
            return DVec3::ZERO;
        }
        let Material { albedo, metallic, .. } = self.material;
        let h = (l + self.view).normalize_or_zero();
        let f0 = DVec3::splat(0.04 * (1.0 - metallic)) + albedo * metallic;
        let fresnel = f0 + (DVec3::ONE - f0) * (1.0 - self.view.dot(h)).clamp(0.0, 1.0).powi(5);
        let a2 = self.alpha().powi(2);
        let lambda = |cos_a: f64, cos_b: f64| cos_a * (cos_b * cos_b * (1.0 - a2) + a2).sqrt();
        let shadowing = 0.5 / (lambda(n_l, n_v) + lambda(n_v, n_l));
        let specular = fresnel * (self.distribution(h) * shadowing);
        (albedo * ((1.0 - metallic) / PI) + specular) * n_l
    }

    fn alpha(&self) -> f64 {
        self.material.roughness.powi(2)
    }

    /// GGX density of half vectors.
    fn distribution(&self, h: DVec3) -> f64 {
        let a2 = self.alpha().powi(2);
        let n_h = self.normal.dot(h).max(0.0);
        a2 / (PI * (n_h * n_h * (a2 - 1.0) + 1.0).powi(2))
    }

    /// The view reflected about a half vector drawn from the distribution.
    fn sample_specular(&self, u: DVec2) -> DVec3 {
        let a2 = self.alpha().powi(2);
        let cosine = ((1.0 - u.x) / (1.0 + (a2 - 1.0) * u.x)).sqrt();
        let h = around(self.normal, cosine, u.y);
        h * (2.0 * self.view.dot(h)) - self.view
    }

    fn specular_density(&self, l: DVec3) -> f64 {
        let h = (l + self.view).normalize_or_zero();
        let v_h = self.view.dot(h);
        if v_h <= 1e-9 { 0.0 } else { self.distribution(h) * self.normal.dot(h).max(0.0) / (4.0 * v_h) }
    }
}

/// The unit vector at `cosine` to `axis`, rotated about it by `turn` of a full circle.
fn around(axis: DVec3, cosine: f64, turn: f64) -> DVec3 {
    let (x, y) = axis.any_orthonormal_pair();
    let (sin_phi, cos_phi) = (TAU * turn).sin_cos();
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    (x * (sine * cos_phi) + y * (sine * sin_phi) + axis * cosine).normalize()
}

/// A direction over `normal` with density cosine / pi.
pub(super) fn sample_cosine(normal: DVec3, u: DVec2) -> DVec3 {
    around(normal, (1.0 - u.x).sqrt(), u.y)
}

/// Samples directions with a density proportional to the luminance of a map, constant in each texel.
pub(super) struct LightSampler {
    width: usize,
    height: usize,
    /// Cumulative probability up to and including each texel.
    cumulative: Vec<f64>,
    /// Density per steradian inside each texel.
    density: Vec<f64>,
}

impl LightSampler {
    /// Density proportional to the mean luminance of `maps`, so that one sampler serves several lights.
    pub(super) fn new(maps: &[EnvMap]) -> Self {
        const SIZE: (usize, usize) = (64, 32);
        let mut power = vec![0.0; SIZE.0 * SIZE.1];
        let directions = texel_directions(SIZE.0, SIZE.1);
        for map in maps {
            let small = map.resampled(SIZE.0, SIZE.1);
            let luminance = |t: &[f32; 3]| f64::from(0.2126 * t[0] + 0.7152 * t[1] + 0.0722 * t[2]);
            let total: f64 = small.texels().iter().zip(&directions).map(|(t, d)| luminance(t) * d.1).sum();
            // A uniform part of a tenth: bilinear lookups see light one texel outside a lamp.
            let share = |t: &[f32; 3]| luminance(t) / total.max(1e-12) + 0.1 / (4.0 * PI);
            power.iter_mut().zip(small.texels()).for_each(|(p, t)| *p += share(t));
        }
        let total: f64 = power.iter().zip(&directions).map(|(p, d)| p * d.1).sum();
        let density: Vec<f64> = power.iter().map(|p| p / total).collect();
        let mut sum = 0.0;
        let mut add = |(p, d): (&f64, &(DVec3, f64))| {
            sum += p * d.1;
            sum
        };
        let cumulative = density.iter().zip(&directions).map(&mut add).collect();
        Self { width: SIZE.0, height: SIZE.1, cumulative, density }
    }

    fn sample(&self, u: DVec2) -> DVec3 {
        let texel = self.cumulative.partition_point(|&c| c < u.x).min(self.density.len() - 1);
        let below = if texel == 0 { 0.0 } else { self.cumulative[texel - 1] };
        // The remainder of `u.x` inside the texel is again uniform.
        let across = ((u.x - below) / (self.cumulative[texel] - below)).clamp(0.0, 1.0);
        let (x, y) = (texel % self.width, texel / self.width);
        let edge = |row: usize| (PI * row as f64 / self.height as f64).cos();
        let z = edge(y) + (edge(y + 1) - edge(y)) * u.y;
        let azimuth = (0.5 - (x as f64 + across) / self.width as f64) * TAU;
        let side = (1.0 - z * z).max(0.0).sqrt();
        DVec3::new(side * azimuth.cos(), side * azimuth.sin(), z)
    }

    fn density(&self, d: DVec3) -> f64 {
        let [u, v] = direction_to_uv(d);
        let x = ((u * self.width as f64) as usize).min(self.width - 1);
        let y = ((v * self.height as f64) as usize).min(self.height - 1);
        self.density[y * self.width + x]
    }
}

/// Weights of the three densities in the mixture.
const COSINE: f64 = 0.3;
const SPECULAR: f64 = 0.3;
const LIGHT: f64 = 0.4;

/// A direction drawn from the mixture, and for it BRDF x cosine / density of the whole mixture.
pub(super) fn sample_mixture(surface: &SurfacePoint, lights: &LightSampler, u: DVec2) -> (DVec3, DVec3) {
    // The remainder of `u.x` after the choice is again uniform and equally well distributed.
    let l = if u.x < COSINE {
        sample_cosine(surface.normal, DVec2::new(u.x / COSINE, u.y))
    } else if u.x < COSINE + SPECULAR {
        surface.sample_specular(DVec2::new((u.x - COSINE) / SPECULAR, u.y))
    } else {
        lights.sample(DVec2::new((u.x - COSINE - SPECULAR) / LIGHT, u.y))
    };
    let value = surface.reflect(l);
    if value == DVec3::ZERO {
        return (l, value);
    }
    let density = COSINE * surface.normal.dot(l) / PI
        + SPECULAR * surface.specular_density(l)
        + LIGHT * lights.density(l);
    (l, value / density)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builtin;

    fn surface(metallic: f64, roughness: f64) -> SurfacePoint {
        let material = Material { albedo: DVec3::new(0.8, 0.5, 0.2), metallic, roughness };
        SurfacePoint { normal: DVec3::Z, view: DVec3::new(0.6, 0.0, 0.8), material }
    }

    /// Reflected radiance under a map, by mixture sampling and by quadrature.
    fn both(surface: &SurfacePoint, map: &EnvMap) -> (DVec3, DVec3) {
        let lights = LightSampler::new(std::slice::from_ref(map));
        let light = |d| DVec3::from(map.sample(d).map(f64::from));
        let n = 46_368;
        let drawn: DVec3 = (0..n)
            .map(|i| {
                let u = DVec2::new(i as f64 + 0.5, i as f64 * 28_657.0) / n as f64;
                let (l, weight) = sample_mixture(surface, &lights, u.fract());
                weight * light(l) / n as f64
            })
            .sum();
        let summed = texel_directions(1024, 512).into_iter().map(|(d, w)| surface.reflect(d) * light(d) * w);
        (drawn, summed.sum())
    }

    #[test]
    fn mixture_sampling_agrees_with_quadrature() {
        for (metallic, roughness) in [(0.0, 0.3), (1.0, 0.4), (0.5, 0.9)] {
            let (drawn, summed) = both(&surface(metallic, roughness), &builtin("sunset").unwrap());
            let error = ((drawn - summed) / summed).abs().max_element();
            assert!(error < 0.01, "{metallic} {roughness}: {drawn} {summed}");
            let (other, _) = both(&surface(metallic, roughness), &builtin("overcast").unwrap());
            assert!(
                ((other - summed) / summed).abs().max_element() > 0.05,
                "the comparison must be able to fail"
            );
        }
    }

    #[test]
    fn white_furnace_never_gains_energy() {
        for roughness in [0.2, 0.5, 1.0] {
            let mut metal = surface(1.0, roughness);
            metal.material.albedo = DVec3::ONE;
            let (drawn, _) = both(&metal, &EnvMap::constant(8, 4, [1.0; 3]));
            assert!(drawn.max_element() < 1.002 && drawn.min_element() > 0.3, "{roughness}: {drawn}");
        }
    }
}
