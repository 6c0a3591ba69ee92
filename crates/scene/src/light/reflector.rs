//! Reflection of light from one direction towards the camera: Lambert and GGX. D, G and F are those that the split-sum table
//! integrates, so that sampled and tabulated shading agree wherever both are exact.

use std::f64::consts::{FRAC_1_PI, PI, TAU};

use glam::DVec3;

use crate::light::brdf::{BrdfLut, ggx_d, ggx_smith_correlated};

/// Material of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Base colour, 0 to 1 per channel.
    pub albedo: [f32; 3],
    /// Metalness, 0 to 1.
    pub metal: f32,
    /// Roughness, 0 to 1.
    pub rough: f32,
    /// True: the diffuse term has the share of the light that the highlight leaves
    /// ([`DiffuseShare`](super::DiffuseShare)).
    pub conserves_energy: bool,
}

/// A surface and the direction from which the camera sees it.
#[derive(Debug, Clone, Copy)]
pub struct Reflector {
    normal: DVec3,
    tangent: DVec3,
    bitangent: DVec3,
    view: DVec3,
    nov: f64,
    alpha: f64,
    /// The diffuse reflectance per steradian.
    diffuse: [f64; 3],
    /// Reflectance at normal incidence.
    f0: [f64; 3],
}

/// Light that the two parts of the surface send to the camera, absolute or per unit of radiance and steradian.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Reflected {
    /// Light of the diffuse part.
    pub diffuse: [f64; 3],
    /// Light of the specular part.
    pub specular: [f64; 3],
}

impl Reflector {
    /// A surface with unit `normal`, seen from the unit direction `view`.
    pub fn new(normal: DVec3, view: DVec3, material: Material) -> Self {
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        let (metal, rough) = (f64::from(material.metal), f64::from(material.rough));
        let albedo = material.albedo.map(f64::from);
        let nov = normal.dot(view).clamp(1e-4, 1.0);
        let share = BrdfLut::shared().sample(nov, rough).diffuse_share(material.conserves_energy).value;
        Self {
            normal,
            tangent,
            bitangent,
            view,
            nov,
            alpha: (rough * rough).max(1e-4),
            diffuse: albedo.map(|a| a * (1.0 - metal) * FRAC_1_PI * share),
            f0: albedo.map(|a| 0.04 * (1.0 - metal) + a * metal),
        }
    }

    /// The diffuse reflectance per steradian.
    pub fn diffuse(&self) -> [f64; 3] {
        self.diffuse
    }

    /// Reflectance times cosine towards unit `light`; `None` below the horizon. `radius` is the angular radius
    /// of the light in radians: it widens the highlight, which would be a speck for a point light.
    pub fn reflect(&self, light: DVec3, radius: f64) -> Option<Reflected> {
        let nol = self.normal.dot(light);
        if !(nol > 0.0) {
            return None;
        }
        // A half vector rotates by half the angle of the light.
        let alpha = (self.alpha * self.alpha + 0.25 * radius * radius).sqrt().min(1.0);
        let half = (self.view + light).normalize_or(self.normal);
        let voh = self.view.dot(half).clamp(0.0, 1.0);
        let lobe = ggx_d(self.normal.dot(half), alpha) * ggx_smith_correlated(self.nov, nol.min(1.0), alpha)
            / (4.0 * self.nov);
        let fresnel = (1.0 - voh).powi(5);
        Some(Reflected {
            diffuse: self.diffuse.map(|d| d * nol),
            specular: self.f0.map(|f0| lobe * (f0 + (1.0 - f0) * fresnel)),
        })
    }

    fn to_world(self, [x, y, z]: [f64; 3]) -> DVec3 {
        x * self.tangent + y * self.bitangent + z * self.normal
    }

    /// A direction from the cosine density, from two numbers in [0, 1).
    pub fn sample_cosine(&self, u: [f64; 2]) -> DVec3 {
        let (sin, phi) = (u[0].sqrt(), TAU * u[1]);
        self.to_world([sin * phi.cos(), sin * phi.sin(), (1.0 - u[0]).sqrt()])
    }

    /// Density of [`Self::sample_cosine`] per steradian.
    pub fn cosine_density(&self, light: DVec3) -> f64 {
        self.normal.dot(light).max(0.0) / PI
    }

    /// A direction from the lobe of half vectors; `None` where it points away from the camera.
    pub fn sample_lobe(&self, u: [f64; 2]) -> Option<DVec3> {
        let cos = ((1.0 - u[0]) / (1.0 + (self.alpha * self.alpha - 1.0) * u[0])).sqrt();
        let (sin, phi) = ((1.0 - cos * cos).max(0.0).sqrt(), TAU * u[1]);
        let half = self.to_world([sin * phi.cos(), sin * phi.sin(), cos]);
        let voh = self.view.dot(half);
        (voh > 0.0).then(|| 2.0 * voh * half - self.view)
    }

    /// Density of [`Self::sample_lobe`] per steradian.
    pub fn lobe_density(&self, light: DVec3) -> f64 {
        let half = (self.view + light).normalize_or_zero();
        let (noh, voh) = (self.normal.dot(half), self.view.dot(half));
        if noh > 0.0 && voh > 0.0 { ggx_d(noh, self.alpha) * noh / (4.0 * voh) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    fn surface(nov: f64, rough: f32) -> Reflector {
        let view = DVec3::new((1.0 - nov * nov).sqrt(), 0.0, nov);
        let material = Material { albedo: [1.0, 0.5, 0.0], metal: 0.0, rough, conserves_energy: true };
        Reflector::new(DVec3::Z, view, material)
    }

    /// The integral of `f` over the half sphere, by midpoints concentrated at the lobe of half vectors.
    fn integrate(r: &Reflector, f: impl Fn(DVec3) -> f64) -> f64 {
        const N: usize = 700;
        let cell = |i: usize| (i as f64 + 0.5) / N as f64;
        let mut sum = 0.0;
        for i in 0..N {
            for j in 0..N {
                let Some(d) = r.sample_lobe([cell(i), cell(j)]) else { continue };
                if d.z > 0.0 {
                    sum += f(d) / r.lobe_density(d);
                }
            }
        }
        sum / (N * N) as f64
    }

    #[test]
    fn lobe_integral_matches_the_split_sum_table() {
        for rough in [0.25f32, 0.5, 0.9] {
            for nov in [0.2, 0.5, 0.95] {
                let r = surface(nov, rough);
                let specular = integrate(&r, |d| r.reflect(d, 0.0).map_or(0.0, |s| s.specular[0]));
                let lut = BrdfLut::shared().sample(nov, f64::from(rough)).value;
                let table = 0.04 * lut[0] + lut[1];
                // The remaining error comes from the table's grid of 32 x 32.
                assert!((specular / table - 1.0).abs() < 0.03, "{rough} {nov}: {specular} {table}");
                let other = BrdfLut::shared().sample(nov, f64::from(rough) + 0.1).value;
                let other = 0.04 * other[0] + other[1];
                assert!((other / table - 1.0).abs() > 0.001, "the control: roughness shows in the table");
            }
        }
    }

    #[test]
    fn white_surface_reflects_all_that_arrives() {
        let energy = |rough, conserves_energy| {
            let material = Material { albedo: [1.0; 3], metal: 0.0, rough, conserves_energy };
            let r = Reflector::new(DVec3::Z, DVec3::new(0.8, 0.0, 0.6), material);
            let reflected = |d| r.reflect(d, 0.0).unwrap_or_default();
            let specular = integrate(&r, |d| reflected(d).specular[0]);
            // The diffuse reflectance is constant: its integral over the cosine is pi times it.
            reflected(DVec3::Z).diffuse[0] * PI + specular
        };
        for rough in [0.2, 0.5, 0.9] {
            let white = energy(rough, true);
            assert!((white - 1.0).abs() < 0.003, "{rough}: {white}");
            assert!(energy(rough, false) > 1.02, "the control");
        }
    }

    #[test]
    fn lobe_integral_is_independent_of_the_direction_grid() {
        // Spherical midpoints instead of half vectors: only this test detects a wrong density.
        let r = surface(0.6, 0.5);
        const ROWS: usize = 900;
        let mut sum = 0.0;
        for (d, w) in crate::texel_directions(2 * ROWS, ROWS) {
            sum += w * r.reflect(d, 0.0).map_or(0.0, |s| s.specular[1]);
        }
        let lobe = integrate(&r, |d| r.reflect(d, 0.0).map_or(0.0, |s| s.specular[1]));
        assert!((sum / lobe - 1.0).abs() < 2e-3, "{sum} {lobe}");
    }

    #[test]
    fn wide_light_spreads_the_highlight_with_unchanged_energy() {
        let r = surface(0.9, 0.1);
        let mirror = DVec3::new(-(1.0 - 0.81f64).sqrt(), 0.0, 0.9);
        let at = |radius| r.reflect(mirror, radius).unwrap().specular[0];
        assert!(at(0.2) < 0.02 * at(0.0), "{} {}", at(0.2), at(0.0));
        let wide = surface(0.9, 0.3);
        let energy = |radius| integrate(&wide, |d| r.reflect(d, radius).map_or(0.0, |s| s.specular[0]));
        assert!((energy(0.1) / energy(0.0) - 1.0).abs() < 0.05, "{} {}", energy(0.1), energy(0.0));
        assert!(r.reflect(-DVec3::Z, 0.0).is_none());
    }
}
