//! The diffuse term of one surface, in a pixel or at a Gaussian (docs/MODEL.md, section 4), forward and backward.

use crate::cpu::surface::{MAX_COEFFICIENTS, Surface, SurfaceGradient, SurfaceShader, dot3};
use relume_scene::light::{LightTables, Taps, UNOCCLUDED_SH0, nrsh_factor, sh_eval, sh_eval_with_gradient};

const INV_PI: f32 = std::f32::consts::FRAC_1_PI;

/// A diffuse term with the values that its backward pass needs.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lambert {
    /// Radiance.
    pub(super) radiance: [f32; 3],
    normal: [f32; 3],
    irradiance: [f32; 3],
    /// Irradiance before the clamp; the next field has it per tap.
    irradiance_raw: [f32; 3],
    tap_irradiance: [[f32; 3]; 4],
    taps: Taps<f32>,
    ambient: f32,
    ambient_raw: f32,
}

/// Dot product of two slices of equal length, a multiple of 16: sixteen running sums, then a fixed tree.
#[inline]
fn dot_padded(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0f32; 16];
    for (x, y) in a.as_chunks::<16>().0.iter().zip(b.as_chunks::<16>().0) {
        for i in 0..16 {
            sums[i] += x[i] * y[i];
        }
    }
    let mut width = 8;
    while width > 0 {
        for i in 0..width {
            sums[i] += sums[i + width];
        }
        width /= 2;
    }
    sums[0]
}

impl SurfaceShader<'_> {
    /// `AO = squash(<c, NRSH(n)>)` (Eq. 16-18) for a unit normal.
    pub fn ambient_occlusion(&self, visibility: &[f32], normal: [f32; 3]) -> f32 {
        if self.is_open() { 1.0 } else { self.ambient_with_raw(visibility, normal).0 }
    }

    fn ambient_with_raw(&self, visibility: &[f32], normal: [f32; 3]) -> (f32, f32) {
        let mut y = [0.0f32; MAX_COEFFICIENTS];
        sh_eval(self.sh_degree, normal, &mut y);
        let mut raw = 0.0;
        for l in 0..=self.sh_degree {
            for j in l * l..(l + 1) * (l + 1) {
                raw += nrsh_factor(l) as f32 * y[j] * visibility[j];
            }
        }
        (self.squash(raw), raw)
    }

    /// The diffuse term of `s`, with its unit `normal` turned to the camera.
    pub(super) fn lambert(&self, s: &Surface, normal: [f32; 3]) -> Lambert {
        // Four tabulated normals around n, each a dot product with the visibility coefficients.
        let taps = self.tables.diffuse_grid.lookup(normal);
        let scalar = self.is_scalar();
        let tap_irradiance: [[f32; 3]; 4] = std::array::from_fn(|k| {
            let rows = self.tables.diffuse_rows(taps.node[k]);
            rows.map(|row| {
                if scalar { row[0] * UNOCCLUDED_SH0 } else { dot_padded(row, &s.visibility[..row.len()]) }
            })
        });
        let mut irradiance_raw = [0.0f32; 3];
        for k in 0..4 {
            (0..3).for_each(|c| irradiance_raw[c] += taps.weight[k] * tap_irradiance[k][c]);
        }
        let (ambient, ambient_raw) =
            if scalar && !self.is_open() { self.ambient_with_raw(&s.visibility, normal) } else { (1.0, 1.0) };
        let irradiance = irradiance_raw.map(|e| e.max(0.0) * ambient);
        let kd = (1.0 - s.metal) * INV_PI;
        let radiance = std::array::from_fn(|c| s.albedo[c] * kd * (irradiance[c] + s.gathered[c]));
        Lambert { radiance, normal, irradiance, irradiance_raw, tap_irradiance, taps, ambient, ambient_raw }
    }

    /// Chain rule through [`Self::lambert`]: adds to `out` and `tables`, returns the gradient by the unit normal.
    pub(super) fn lambert_backward(
        &self,
        s: &Surface,
        f: &Lambert,
        g: [f32; 3],
        tables: &mut LightTables,
        out: &mut SurfaceGradient,
    ) -> [f32; 3] {
        let kd = (1.0 - s.metal) * INV_PI;
        let scalar = self.is_scalar();
        let mut by_irradiance = [0.0f32; 3];
        let mut by_ambient = 0.0;
        for c in 0..3 {
            let light = f.irradiance[c] + s.gathered[c];
            out.albedo[c] += g[c] * kd * light;
            out.metal -= g[c] * s.albedo[c] * INV_PI * light;
            let by_light = g[c] * s.albedo[c] * kd;
            out.gathered[c] = by_light;
            if f.irradiance_raw[c] > 0.0 {
                by_irradiance[c] = by_light * f.ambient;
                by_ambient += by_light * f.irradiance_raw[c];
            }
        }
        let mut by_normal = [0.0f32; 3];
        let n = tables.coefficients;
        for k in 0..4 {
            let along = dot3(by_irradiance, f.tap_irradiance[k]);
            (0..3).for_each(|a| by_normal[a] += along * f.taps.gradient[k][a]);
            let node = f.taps.node[k];
            for c in 0..3 {
                let w = f.taps.weight[k] * by_irradiance[c];
                let base = (node * 3 + c) * n;
                let row = &mut tables.diffuse[base..base + n];
                if scalar {
                    row[0] += w * UNOCCLUDED_SH0;
                    continue;
                }
                let table = &self.tables.diffuse[base..base + n];
                for j in 0..n {
                    row[j] += w * s.visibility[j];
                    out.visibility[j] += w * table[j];
                }
            }
        }
        if scalar && !self.is_open() {
            let by_raw = by_ambient * self.squash_derivative(f.ambient_raw, f.ambient);
            let (mut y, mut dy) = ([0.0f32; MAX_COEFFICIENTS], [[0.0f32; 3]; MAX_COEFFICIENTS]);
            sh_eval_with_gradient(self.sh_degree, f.normal, &mut y, &mut dy);
            for l in 0..=self.sh_degree {
                let factor = by_raw * nrsh_factor(l) as f32;
                for j in l * l..(l + 1) * (l + 1) {
                    out.visibility[j] += factor * y[j];
                    (0..3).for_each(|a| by_normal[a] += factor * s.visibility[j] * dy[j][a]);
                }
            }
        }
        by_normal
    }
}
