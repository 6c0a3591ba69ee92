//! Attenuation of each SH degree by a GGX reflection lobe: visibility averaged over the lobe instead of along one ray.

use std::f64::consts::PI;

use num_traits::Float;

use crate::light::brdf::ggx_d;
use relume_layout::light::{LOBE_DEGREES, LOBE_ROUGHNESSES};

/// Zonal attenuation `h_l(roughness)`, with `h_0 = 1`, of the prefilter lobe around the reflection.
#[derive(Debug, Clone)]
pub struct LobeAttenuation {
    rows: [[f32; LOBE_DEGREES]; LOBE_ROUGHNESSES],
}

/// `h_l` and its derivative by roughness.
#[derive(Debug, Clone, Copy)]
pub struct LobeSample<T> {
    /// `h_l`, l = 0..=8.
    pub value: [T; LOBE_DEGREES],
    /// `d h_l / d roughness`.
    pub by_roughness: [T; LOBE_DEGREES],
}

impl LobeAttenuation {
    /// The table every engine uses, built once.
    pub fn shared() -> &'static Self {
        static TABLE: std::sync::LazyLock<LobeAttenuation> = std::sync::LazyLock::new(|| {
            let row = |i: usize| attenuation(i as f64 / (LOBE_ROUGHNESSES - 1) as f64).map(|v| v as f32);
            LobeAttenuation { rows: std::array::from_fn(row) }
        });
        &TABLE
    }

    /// `h_l` at equally spaced roughnesses from 0 to 1.
    pub fn rows(&self) -> &[[f32; LOBE_DEGREES]] {
        &self.rows
    }

    /// Linear interpolation in roughness, clamped to [0, 1].
    #[inline]
    pub fn sample<T: Float>(&self, roughness: T) -> LobeSample<T> {
        let cells = T::from(LOBE_ROUGHNESSES - 1).unwrap_or_else(T::one);
        let x = (roughness * cells).max(T::zero()).min(cells);
        let i = x.to_usize().unwrap_or(0).min(LOBE_ROUGHNESSES - 2);
        let f = x - T::from(i).unwrap_or_else(T::zero);
        let inside = roughness > T::zero() && roughness < T::one();
        let derivative = if inside { cells } else { T::zero() };
        let at = |i: usize, l: usize| T::from(self.rows[i][l]).unwrap_or_else(T::nan);
        LobeSample {
            value: std::array::from_fn(|l| at(i, l) * (T::one() - f) + at(i + 1, l) * f),
            by_roughness: std::array::from_fn(|l| (at(i + 1, l) - at(i, l)) * derivative),
        }
    }
}

/// `h_l = int K P_l / int K` over the half sphere around R, `K = D(cos(theta / 2)) cos(theta)`.
fn attenuation(roughness: f64) -> [f64; LOBE_DEGREES] {
    let alpha = (roughness * roughness).max(1e-3);
    let mut sums = [0.0; LOBE_DEGREES];
    // Substituting theta = (pi/2) t^4 concentrates the steps where a sharp lobe is.
    const STEPS: usize = 4000;
    for i in 0..STEPS {
        let t = (i as f64 + 0.5) / STEPS as f64;
        let theta = 0.5 * PI * t.powi(4);
        let weight = ggx_d((0.5 * theta).cos(), alpha) * theta.cos() * theta.sin() * t.powi(3);
        let z = theta.cos();
        let (mut previous, mut current) = (1.0, z);
        sums[0] += weight;
        sums[1] += weight * z;
        for (l, sum) in sums.iter_mut().enumerate().skip(2) {
            let n = l as f64;
            let next = ((2.0 * n - 1.0) * z * current - (n - 1.0) * previous) / n;
            (previous, current) = (current, next);
            *sum += weight * next;
        }
    }
    sums.map(|s| s / sums[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lobe_attenuation_is_one_for_a_mirror_and_falls_if_rough() {
        let table = LobeAttenuation::shared();
        let mirror = table.sample(0.0f64).value;
        assert!(mirror.iter().all(|h| *h > 0.97), "{mirror:?}");
        for l in 1..LOBE_DEGREES {
            let h = |r: f64| table.sample(r).value[l];
            assert!(h(0.2) > h(0.5) && h(0.5) > h(0.9), "degree {l}");
        }
        assert!((table.sample(0.7f64).value[0] - 1.0).abs() < 1e-6);
    }
}
