//! The GGX microfacet lobe and the split-sum table of its directional albedo.

use std::f64::consts::PI;

use num_traits::Float;

use relume_layout::light::{DIELECTRIC_F0, LUT_SIZE};

/// GGX normal distribution, per steradian of half vectors; `alpha = roughness^2`.
pub fn ggx_d(cos_h: f64, alpha: f64) -> f64 {
    let a2 = alpha * alpha;
    let denominator = cos_h * cos_h * (a2 - 1.0) + 1.0;
    a2 / (PI * denominator * denominator).max(1e-300)
}

/// Height-correlated Smith shadowing-masking of GGX (Heitz 2014, Eq. 99), for cosines in (0, 1].
pub fn ggx_smith_correlated(nov: f64, nol: f64, alpha: f64) -> f64 {
    let a2 = alpha * alpha;
    let v = nol * (a2 + (1.0 - a2) * nov * nov).sqrt();
    let l = nov * (a2 + (1.0 - a2) * nol * nol).sqrt();
    2.0 * nov * nol / (v + l).max(1e-300)
}

/// The split-sum table (Karis 2013): `specular albedo = F0 * scale + bias`.
#[derive(Debug, Clone, PartialEq)]
pub struct BrdfLut {
    resolution: usize,
    /// `[roughness][n.v]`, texel centres at (i + 0.5) / resolution.
    values: Vec<[f32; 2]>,
}

/// A look-up with its derivatives.
#[derive(Debug, Clone, Copy)]
pub struct LutSample<T> {
    /// `[scale, bias]`.
    pub value: [T; 2],
    /// d value / d (n.v).
    pub by_nov: [T; 2],
    /// d value / d roughness.
    pub by_roughness: [T; 2],
}

/// Share of the light that the highlight of a dielectric leaves for the diffuse term below it, with derivatives:
/// `1 - (F0 scale + bias)` with `F0` = [`DIELECTRIC_F0`], between 0 and 1. With it a white surface under uniform light reflects
/// exactly what arrives (albedo scaling; Kulla and Conty 2017).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DiffuseShare<T> {
    /// The share.
    pub value: T,
    /// d value / d (n.v).
    pub by_nov: T,
    /// d value / d roughness.
    pub by_roughness: T,
}

impl<T: Float> LutSample<T> {
    /// The share of a diffuse term that conserves energy; 1 for one that does not.
    pub fn diffuse_share(&self, conserves_energy: bool) -> DiffuseShare<T> {
        if !conserves_energy {
            return DiffuseShare { value: T::one(), by_nov: T::zero(), by_roughness: T::zero() };
        }
        let f0 = T::from(DIELECTRIC_F0).unwrap_or_else(T::nan);
        let reflected = |[scale, bias]: [T; 2]| f0 * scale + bias;
        DiffuseShare {
            value: T::one() - reflected(self.value),
            by_nov: -reflected(self.by_nov),
            by_roughness: -reflected(self.by_roughness),
        }
    }
}

impl BrdfLut {
    /// Integrates the table with `samples` low-discrepancy half vectors per texel.
    pub fn build(resolution: usize, samples: u32) -> Self {
        let mut values = Vec::with_capacity(resolution * resolution);
        for row in 0..resolution {
            for column in 0..resolution {
                let centre = |i: usize| (i as f64 + 0.5) / resolution as f64;
                let [scale, bias] = integrate(centre(column), centre(row), samples);
                values.push([scale as f32, bias as f32]);
            }
        }
        Self { resolution, values }
    }

    /// The table every engine uses: [`LUT_SIZE`] texels a side, 4,096 samples, built once.
    pub fn shared() -> &'static Self {
        static TABLE: std::sync::LazyLock<BrdfLut> =
            std::sync::LazyLock::new(|| BrdfLut::build(LUT_SIZE, 4096));
        &TABLE
    }

    /// The texels, `[roughness][n.v]` of `[scale, bias]`.
    pub fn values(&self) -> &[[f32; 2]] {
        &self.values
    }

    /// Bilinear look-up, clamped at the border, with derivatives (zero where clamped).
    #[inline]
    pub fn sample<T: Float>(&self, nov: T, roughness: T) -> LutSample<T> {
        let n = self.resolution;
        let size = T::from(n).unwrap_or_else(T::one);
        let half = T::from(0.5).unwrap_or_else(T::one);
        let last = T::from(n - 1).unwrap_or_else(T::one);
        // (cell, fraction, d fraction / d coordinate)
        let cell = |v: T| -> (usize, T, T) {
            let x = v * size - half;
            if !(x > T::zero()) {
                (0, T::zero(), T::zero())
            } else if x >= last {
                (n.saturating_sub(2), if n > 1 { T::one() } else { T::zero() }, T::zero())
            } else {
                let i = x.floor();
                (i.to_usize().unwrap_or(0), x - i, size)
            }
        };
        let ((i, fx, dx), (j, fy, dy)) = (cell(nov), cell(roughness));
        let at = |jj: usize, ii: usize, k: usize| -> T {
            let v = self.values[jj.min(n - 1) * n + ii.min(n - 1)][k];
            T::from(v).unwrap_or_else(T::nan)
        };
        let one = T::one();
        let mut out =
            LutSample { value: [T::zero(); 2], by_nov: [T::zero(); 2], by_roughness: [T::zero(); 2] };
        for k in 0..2 {
            let (a, b, c, d) = (at(j, i, k), at(j, i + 1, k), at(j + 1, i, k), at(j + 1, i + 1, k));
            let (top, bottom) = (a * (one - fx) + b * fx, c * (one - fx) + d * fx);
            out.value[k] = top * (one - fy) + bottom * fy;
            out.by_nov[k] = ((b - a) * (one - fy) + (d - c) * fy) * dx;
            out.by_roughness[k] = (bottom - top) * dy;
        }
        out
    }
}

/// Scale and bias at one (n.v, roughness), sampling half vectors from GGX.
fn integrate(nov: f64, roughness: f64, samples: u32) -> [f64; 2] {
    let alpha = (roughness * roughness).max(1e-4);
    let view = [(1.0 - nov * nov).sqrt(), 0.0, nov];
    let (mut scale, mut bias) = (0.0, 0.0);
    for i in 0..samples {
        let u1 = (f64::from(i) + 0.5) / f64::from(samples);
        let u2 = (f64::from(i.reverse_bits()) + 0.5) / 4_294_967_296.0;
        let cos_h = ((1.0 - u2) / (1.0 + (alpha * alpha - 1.0) * u2)).sqrt();
        let sin_h = (1.0 - cos_h * cos_h).max(0.0).sqrt();
        let phi = 2.0 * PI * u1;
        let voh = view[0] * sin_h * phi.cos() + view[2] * cos_h;
        let nol = 2.0 * voh * cos_h - nov;
        if voh <= 0.0 || nol <= 0.0 {
            continue;
        }
        let weight = ggx_smith_correlated(nov, nol, alpha) * voh / (cos_h * nov);
        let fresnel = (1.0 - voh).powi(5);
        scale += (1.0 - fresnel) * weight;
        bias += fresnel * weight;
    }
    [scale / f64::from(samples), bias / f64::from(samples)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brdf_table_never_gains_energy_and_a_mirror_keeps_it() {
        let lut = BrdfLut::shared();
        for r in 0..=20 {
            for v in 0..=20 {
                // F0 = 1: the surface reflects everything that the microfacets do not shadow.
                let s = lut.sample(f64::from(v) / 20.0, f64::from(r) / 20.0).value;
                assert!(s[0] + s[1] <= 1.0 + 1e-3 && s[0] >= 0.0 && s[1] >= 0.0, "{r} {v} {s:?}");
            }
        }
        let mirror = lut.sample(1.0f64, 0.0).value;
        assert!((mirror[0] + mirror[1] - 1.0).abs() < 2e-3, "{mirror:?}");
        let rough = lut.sample(1.0f64, 1.0).value;
        assert!(rough[0] + rough[1] < 0.95, "single scattering must lose energy when rough: {rough:?}");
    }

    #[test]
    fn diffuse_share_is_what_the_highlight_leaves() {
        let lut = BrdfLut::shared();
        let sample = lut.sample(0.2f64, 0.3);
        let share = sample.diffuse_share(true);
        let reflected = f64::from(DIELECTRIC_F0) * sample.value[0] + sample.value[1];
        assert!((share.value + reflected - 1.0).abs() < 1e-9 && share.value < 0.95, "{share:?}");
        let step = 1e-6;
        let at = |nov, rough| lut.sample(nov, rough).diffuse_share(true).value;
        let by_nov = (at(0.2 + step, 0.3) - at(0.2 - step, 0.3)) / (2.0 * step);
        let by_roughness = (at(0.2, 0.3 + step) - at(0.2, 0.3 - step)) / (2.0 * step);
        assert!((by_nov - share.by_nov).abs() < 1e-6 && share.by_nov > 0.01, "{share:?}");
        assert!((by_roughness - share.by_roughness).abs() < 1e-6 && share.by_roughness != 0.0, "{share:?}");
        assert_eq!(sample.diffuse_share(false).value, 1.0, "the control");
    }

    #[test]
    fn brdf_table_derivatives_agree_with_differences() {
        let lut = BrdfLut::shared();
        let (nov, rough) = (0.371, 0.522);
        let s = lut.sample(nov, rough);
        for k in 0..2 {
            let dn = (lut.sample(nov + 1e-6, rough).value[k] - lut.sample(nov - 1e-6, rough).value[k]) / 2e-6;
            let dr = (lut.sample(nov, rough + 1e-6).value[k] - lut.sample(nov, rough - 1e-6).value[k]) / 2e-6;
            assert!((dn - s.by_nov[k]).abs() < 1e-6 && (dr - s.by_roughness[k]).abs() < 1e-6);
        }
    }
}
