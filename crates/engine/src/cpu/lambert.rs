//! The diffuse term of one surface, in a pixel or at a Gaussian (docs/MODEL.md, section 4), forward and backward.

use multiversion::multiversion;

use crate::cpu::surface::{MAX_COEFFICIENTS, Surface, SurfaceGradient, SurfaceShader, dot3};
use relume_scene::light::{LightTables, Taps, UNOCCLUDED_SH0, nrsh_factor, sh_eval, sh_eval_with_gradient};

const INV_PI: f32 = std::f32::consts::FRAC_1_PI;

/// A diffuse term with the values that its backward pass needs.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lambert {
    /// Radiance.
    pub(super) radiance: [f32; 3],
    normal: [f32; 3],
    gathered: [f32; 3],
    irradiance: [f32; 3],
    /// Irradiance before the clamp; the next field has it per tap.
    irradiance_raw: [f32; 3],
    tap_irradiance: [[f32; 3]; 4],
    taps: Taps<f32>,
    ambient: f32,
    ambient_raw: f32,
}

/// Dot product of two slices of equal length, a multiple of 16: sixteen running sums, then a fixed tree.
#[inline(always)]
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

/// Start of the rows of `node` in a table with `n` coefficients per colour.
#[inline(always)]
fn rows_at(node: usize, n: usize) -> usize {
    3 * node * n
}

/// Irradiance at four nodes of `diffuse` through the visibility `v` (padded): `[node][rgb]`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
fn irradiance_at(diffuse: &[f32], nodes: &[usize; 4], v: &[f32]) -> [[f32; 3]; 4] {
    let n = v.len();
    nodes.map(|node| {
        let rows = &diffuse[rows_at(node, n)..][..3 * n];
        [0, 1, 2].map(|c| dot_padded(&rows[c * n..(c + 1) * n], v))
    })
}

/// Adds the gradient of [`irradiance_at`] by the table to `diffuse`: `by` times the visibility `v`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
fn add_to_table(diffuse: &mut [f32], nodes: &[usize; 4], by: &[[f32; 3]; 4], v: &[f32]) {
    let n = v.len();
    for (node, by) in nodes.iter().zip(by) {
        let rows = &mut diffuse[rows_at(*node, n)..][..3 * n];
        for (row, by) in rows.chunks_exact_mut(n).zip(by) {
            row.iter_mut().zip(v).for_each(|(o, v)| *o += by * v);
        }
    }
}

/// Adds the gradient of [`irradiance_at`] by the visibility to `out`, which is padded.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
fn add_to_visibility(diffuse: &[f32], nodes: &[usize; 4], by: &[[f32; 3]; 4], out: &mut [f32]) {
    let n = out.len();
    for (node, by) in nodes.iter().zip(by) {
        let rows = &diffuse[rows_at(*node, n)..][..3 * n];
        for (row, by) in rows.chunks_exact(n).zip(by) {
            out.iter_mut().zip(row).for_each(|(o, t)| *o += by * t);
        }
    }
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

    /// The diffuse term of `s` with the unit `normal` turned to the camera, where light of `gathered` arrives from other surfaces and from
    /// dominant lights.
    pub(super) fn lambert(&self, s: &Surface, gathered: [f32; 3], normal: [f32; 3]) -> Lambert {
        // Four tabulated normals around n, each a dot product with the visibility coefficients.
        let taps = self.tables.diffuse_grid.lookup(normal);
        let scalar = self.is_scalar();
        let tap_irradiance = if scalar {
            taps.node.map(|node| self.tables.diffuse_rows(node).map(|row| row[0] * UNOCCLUDED_SH0))
        } else {
            irradiance_at(&self.tables.diffuse, &taps.node, &s.visibility[..self.tables.coefficients])
        };
        let mut irradiance_raw = [0.0f32; 3];
        for k in 0..4 {
            (0..3).for_each(|c| irradiance_raw[c] += taps.weight[k] * tap_irradiance[k][c]);
        }
        let (ambient, ambient_raw) =
            if scalar && !self.is_open() { self.ambient_with_raw(&s.visibility, normal) } else { (1.0, 1.0) };
        let irradiance = irradiance_raw.map(|e| e.max(0.0) * ambient);
        let kd = (1.0 - s.metal) * INV_PI;
        let radiance = std::array::from_fn(|c| s.albedo[c] * kd * (irradiance[c] + gathered[c]));
        Lambert {
            radiance,
            normal,
            gathered,
            irradiance,
            irradiance_raw,
            tap_irradiance,
            taps,
            ambient,
            ambient_raw,
        }
    }

    /// Chain rule through [`Self::lambert`]: adds to `out` and `tables`, returns the gradient by the unit normal. The gradient by visibility
    /// is complete only if `trains_visibility`.
    pub(super) fn lambert_backward(
        &self,
        s: &Surface,
        f: &Lambert,
        g: [f32; 3],
        tables: &mut LightTables,
        out: &mut SurfaceGradient,
        trains_visibility: bool,
    ) -> [f32; 3] {
        let kd = (1.0 - s.metal) * INV_PI;
        let scalar = self.is_scalar();
        let mut by_irradiance = [0.0f32; 3];
        let mut by_ambient = 0.0;
        for c in 0..3 {
            let light = f.irradiance[c] + f.gathered[c];
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
        let mut by_taps = [[0.0f32; 3]; 4];
        for k in 0..4 {
            let along = dot3(by_irradiance, f.tap_irradiance[k]);
            (0..3).for_each(|a| by_normal[a] += along * f.taps.gradient[k][a]);
            by_taps[k] = by_irradiance.map(|g| f.taps.weight[k] * g);
        }
        let n = tables.coefficients;
        if scalar {
            for (node, by) in f.taps.node.iter().zip(by_taps) {
                (0..3).for_each(|c| tables.diffuse[rows_at(*node, n) + c * n] += by[c] * UNOCCLUDED_SH0);
            }
        } else {
            add_to_table(&mut tables.diffuse, &f.taps.node, &by_taps, &s.visibility[..n]);
            if trains_visibility {
                add_to_visibility(&self.tables.diffuse, &f.taps.node, &by_taps, &mut out.visibility[..n]);
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
