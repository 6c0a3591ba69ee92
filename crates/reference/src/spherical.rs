//! Real spherical harmonics on the tape, from the associated Legendre recurrences, and the fixed direction sets of the
//! article.

use std::f64::consts::PI;

use super::array::Array;
use super::ops::concat;
use super::tape::Var;

/// Eigenvalues of the clamped cosine per SH degree (Funk-Hecke): `int (n.w)+ Y_lm(w) dw = lambda_l Y_lm(n)`.
/// Beyond degree 6 the kernel counts as 0.
pub const CLAMPED_COSINE: [f64; 7] = [PI, 2.0 * PI / 3.0, PI / 4.0, 0.0, -PI / 24.0, 0.0, PI / 64.0];

/// Orthonormal real SH up to degree `sh_degree` of unit rows (n, 3) -> (n, (degree + 1)^2), index `l*l + l + m`.
///
/// `Y_lm = N_lm P_lm(z) / sin^m * Re or Im (x + iy)^m`: polynomial in x, y, z, hence smooth at the poles.
pub fn real_sh(directions: Var<'_>, sh_degree: usize) -> Var<'_> {
    let (x, y, z) = (directions.column(0), directions.column(1), directions.column(2));
    let one = x * 0.0 + 1.0;
    let mut columns = vec![one; (sh_degree + 1) * (sh_degree + 1)];
    // (x + iy)^m and the sectoral P_mm / sin^m = (-1)^m (2m - 1)!!
    let (mut cosine, mut sine, mut sectoral) = (one, one * 0.0, 1.0);
    for m in 0..=sh_degree {
        let (mut previous, mut legendre) = (one * 0.0, one * sectoral);
        for l in m..=sh_degree {
            if m == 0 {
                columns[l * l + l] = legendre * norm(l, 0);
            } else {
                let scaled = legendre * (std::f64::consts::SQRT_2 * norm(l, m));
                columns[l * l + l + m] = scaled * cosine;
                columns[l * l + l - m] = scaled * sine;
            }
            let next = (z * legendre * (2 * l + 1) as f64 - previous * (l + m) as f64) / (l + 1 - m) as f64;
            (previous, legendre) = (legendre, next);
        }
        (cosine, sine) = (x * cosine - y * sine, x * sine + y * cosine);
        sectoral *= -((2 * m + 1) as f64);
    }
    concat(directions.tape, 1, &columns)
}

/// SH degree l of each coefficient up to `sh_degree`, by index.
pub fn degrees(sh_degree: usize) -> Vec<usize> {
    (0..=sh_degree).flat_map(|l| std::iter::repeat_n(l, 2 * l + 1)).collect()
}

/// The highest degree of SH coefficients (n, (degree + 1)^2).
pub fn sh_degree_of(coefficients: Var<'_>) -> usize {
    coefficients.value().shape()[1].isqrt() - 1
}

/// Normal-related SH of unit rows (n, 3) -> (n, (degree + 1)^2): `AO = <c, NRSH(n)>` (article Eq. 16-18).
pub fn normal_related_sh(normals: Var<'_>, sh_degree: usize) -> Var<'_> {
    let factor = |l: usize| CLAMPED_COSINE.get(l).map_or(0.0, |lambda| lambda / PI);
    let factors: Vec<f64> = degrees(sh_degree).into_iter().map(factor).collect();
    real_sh(normals, sh_degree) * normals.tape.input(Array::new(&[factors.len()], factors))
}

/// `n` directions spread evenly over the sphere on a golden spiral, (n, 3).
pub fn fibonacci_sphere(n: usize) -> Array {
    let direction = |i: usize| {
        let i = i as f64 + 0.5;
        let z = 1.0 - 2.0 * i / n as f64;
        let (sine, cosine) = (PI * (1.0 + 5f64.sqrt()) * i).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        [cosine * radius, sine * radius, z]
    };
    Array::from_rows(&(0..n).map(direction).collect::<Vec<_>>())
}

/// `sqrt((2l + 1) / 4pi (l - m)! / (l + m)!)`
fn norm(l: usize, m: usize) -> f64 {
    let ratio: f64 = (l - m + 1..=l + m).map(|k| k as f64).product();
    ((2 * l + 1) as f64 / (4.0 * PI * ratio)).sqrt()
}
