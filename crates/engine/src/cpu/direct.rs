//! Shading by the dominant lights, which the tables do not contain (docs/MODEL.md, section 4), forward and backward.

use crate::cpu::project::{normalise, normalise_backward};
use crate::cpu::surface::{Surface, SurfaceGradient, SurfaceShader, dot3};
use relume_scene::light::{DIELECTRIC_F0, LightTables, TableLight};

/// Smallest `alpha = roughness^2` of a highlight.
const MIN_GGX_ALPHA: f32 = 1e-4;

/// Light of the dominant lights at a surface.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Direct {
    /// Irradiance.
    pub(super) irradiance: [f32; 3],
    /// Specular radiance.
    pub(super) specular: [f32; 3],
}

/// Gradient of the light that dominant lights add, by the inputs that they share with other terms.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct DirectGradient {
    /// Gradient by the unit normal turned to the camera, without the path through `n . v`.
    pub(super) normal: [f32; 3],
    /// Gradient by `n . v`.
    pub(super) nov: f32,
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Reflection of one light by the facets of a surface: `D G / (4 n.v n.w)` times `n.w`, and Fresnel's part.
#[derive(Debug, Clone, Copy)]
struct Highlight {
    nol: f32,
    nov: f32,
    half: [f32; 3],
    half_length: f32,
    /// `n x h`: its square is `1 - (n . h)^2` without cancellation.
    across: [f32; 3],
    across_squared: f32,
    /// Square of the widened lobe's alpha, and its derivative by roughness.
    alpha_squared: f32,
    alpha_squared_by_rough: f32,
    /// `alpha^2 (n.h)^2 + 1 - (n.h)^2`.
    spread: f32,
    distribution: f32,
    /// `sqrt(alpha^2 + (1 - alpha^2) (n.w)^2)`, and the same of `n.v`.
    roots: [f32; 2],
    /// `n.w G / (4 n.v n.w)`.
    shadowing: f32,
    /// `(1 - v.h)^5`.
    fresnel: f32,
}

impl Highlight {
    fn new(s: &Surface, normal: [f32; 3], nov: f32, nol: f32, light: &TableLight) -> Self {
        let (half, half_length) = normalise(std::array::from_fn(|k| s.view[k] + light.direction[k]));
        let across = cross(normal, half);
        let across_squared = dot3(across, across);
        let alpha = (s.rough * s.rough).max(MIN_GGX_ALPHA);
        let widened = alpha * alpha + 0.25 * light.radius * light.radius;
        let alpha_squared = widened.min(1.0);
        let is_inside = s.rough * s.rough > MIN_GGX_ALPHA && widened < 1.0;
        let spread = alpha_squared + (1.0 - alpha_squared) * across_squared;
        let root = |cos: f32| (alpha_squared + (1.0 - alpha_squared) * cos * cos).sqrt();
        let roots = [root(nol), root(nov)];
        Self {
            nol,
            nov,
            half,
            half_length,
            across,
            across_squared,
            alpha_squared,
            alpha_squared_by_rough: if is_inside { 4.0 * alpha * s.rough } else { 0.0 },
            spread,
            distribution: alpha_squared / (std::f32::consts::PI * spread * spread),
            roots,
            shadowing: 0.5 * nol / (nov * roots[0] + nol * roots[1]),
            fresnel: (1.0 - 0.5 * half_length).max(0.0).powi(5),
        }
    }

    /// Reflectance times `n.w`, without Fresnel's part.
    fn lobe(&self) -> f32 {
        self.distribution * self.shadowing
    }

    fn reflectance(&self, f0: f32) -> f32 {
        f0 + (1.0 - f0) * self.fresnel
    }

    /// Chain rule from the gradients by `n.w`, by [`Self::lobe`] and by Fresnel's part. Returns the gradients that have no
    /// field in `out`.
    fn backward(
        &self,
        [by_nol, by_lobe, by_fresnel]: [f32; 3],
        normal: [f32; 3],
        light: &TableLight,
        out: &mut SurfaceGradient,
    ) -> DirectGradient {
        let [root_nol, root_nov] = self.roots;
        let a = self.alpha_squared;
        let sum = self.nov * root_nol + self.nol * root_nov;
        let by_distribution = by_lobe * self.shadowing;
        let by_shadowing = by_lobe * self.distribution;
        let by_sum = -by_shadowing * self.shadowing / sum;
        // The distribution, by the sine of the half vector and by alpha.
        let by_across = by_distribution * self.distribution * -2.0 * (1.0 - a) / self.spread;
        let mut by_alpha =
            by_distribution * self.distribution * (1.0 / a - 2.0 * (1.0 - self.across_squared) / self.spread);
        by_alpha += by_sum * self.nov * 0.5 * (1.0 - self.nol * self.nol) / root_nol;
        by_alpha += by_sum * self.nol * 0.5 * (1.0 - self.nov * self.nov) / root_nov;
        out.rough += by_alpha * self.alpha_squared_by_rough;
        let by_nol = by_nol
            + by_shadowing * 0.5 / sum
            + by_sum * (self.nov * (1.0 - a) * self.nol / root_nol + root_nov);
        let by_nov = by_sum * (root_nol + self.nol * (1.0 - a) * self.nov / root_nov);
        // d |n x h|^2 = 2 dn . (h x (n x h)) + 2 dh . ((n x h) x n).
        let (turned, bent) = (cross(self.half, self.across), cross(self.across, normal));
        let by_half = bent.map(|v| 2.0 * by_across * v);
        let by_sum_of_both = normalise_backward(self.half, self.half_length, by_half);
        // v . h is half the length of v + w.
        let away = (1.0 - 0.5 * self.half_length).max(0.0);
        let by_length = -2.5 * by_fresnel * away.powi(4);
        (0..3).for_each(|k| out.view[k] += by_sum_of_both[k] + by_length * self.half[k]);
        DirectGradient {
            normal: std::array::from_fn(|k| by_nol * light.direction[k] + 2.0 * by_across * turned[k]),
            nov: by_nov,
        }
    }
}

fn head_on(s: &Surface, c: usize) -> f32 {
    DIELECTRIC_F0 * (1.0 - s.metal) + s.albedo[c] * s.metal
}

/// Light that one dominant light, of which the share `arriving` arrives, adds at a surface with unit `normal` turned to the
/// camera. `None` where it adds nothing.
#[inline]
pub(super) fn direct_of(
    s: &Surface,
    (normal, nov): ([f32; 3], f32),
    light: &TableLight,
    arriving: f32,
) -> Option<Direct> {
    let nol = dot3(normal, light.direction);
    if !(nol > 0.0 && arriving > 0.0) {
        return None;
    }
    let highlight = Highlight::new(s, normal, nov, nol, light);
    let mut out = Direct::default();
    for c in 0..3 {
        let irradiance = arriving * light.irradiance[c];
        out.irradiance[c] = irradiance * nol;
        out.specular[c] = irradiance * highlight.lobe() * highlight.reflectance(head_on(s, c));
    }
    Some(out)
}

impl SurfaceShader<'_> {
    /// Light that the dominant lights add at a surface with unit `normal` turned to the camera; `None` without lights.
    pub(super) fn direct(&self, s: &Surface, normal: [f32; 3], nov: f32) -> Option<Direct> {
        if self.tables.lights.is_empty() {
            return None;
        }
        let mut out = Direct::default();
        for (light, arriving) in self.tables.lights.iter().zip(s.arriving) {
            let Some(one) = direct_of(s, (normal, nov), light, arriving) else { continue };
            for c in 0..3 {
                out.irradiance[c] += one.irradiance[c];
                out.specular[c] += one.specular[c];
            }
        }
        Some(out)
    }

    /// Chain rule through [`Self::direct`]: `by_irradiance` and `by_specular` are the gradients by its parts. Adds to `out`
    /// (to its `view` without the path through `n . v`) and to the lights of `tables`.
    pub(super) fn direct_backward(
        &self,
        s: &Surface,
        (normal, nov): ([f32; 3], f32),
        (by_irradiance, by_specular): ([f32; 3], [f32; 3]),
        tables: &mut LightTables,
        out: &mut SurfaceGradient,
    ) -> DirectGradient {
        let mut sum = DirectGradient::default();
        let lights = self.tables.lights.iter().zip(&mut tables.lights).zip(s.arriving);
        for ((light, by_light), arriving) in lights {
            let nol = dot3(normal, light.direction);
            if !(nol > 0.0 && arriving > 0.0) {
                continue;
            }
            let highlight = Highlight::new(s, normal, nov, nol, light);
            let lobe = highlight.lobe();
            let (mut by_nol, mut by_lobe, mut by_fresnel) = (0.0, 0.0, 0.0);
            for c in 0..3 {
                let (irradiance, f0) = (arriving * light.irradiance[c], head_on(s, c));
                let reflectance = highlight.reflectance(f0);
                by_light.irradiance[c] +=
                    arriving * (by_irradiance[c] * nol + by_specular[c] * lobe * reflectance);
                by_nol += by_irradiance[c] * irradiance;
                by_lobe += by_specular[c] * irradiance * reflectance;
                let by_reflectance = by_specular[c] * irradiance * lobe;
                by_fresnel += by_reflectance * (1.0 - f0);
                let by_f0 = by_reflectance * (1.0 - highlight.fresnel);
                out.albedo[c] += by_f0 * s.metal;
                out.metal += by_f0 * (s.albedo[c] - DIELECTRIC_F0);
            }
            let by = highlight.backward([by_nol, by_lobe, by_fresnel], normal, light, out);
            (0..3).for_each(|k| sum.normal[k] += by.normal[k]);
            sum.nov += by.nov;
        }
        sum
    }
}
