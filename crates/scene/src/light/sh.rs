//! Real spherical harmonics of any degree, without angles, so values and gradients stay finite at the poles.
//!
//! Index of (l, m) is `l*l + l + m`; the basis is orthonormal and carries the Condon-Shortley sign, as in the
//! article's listing. With `Q_l^m = (-1)^m d^m P_l / dz^m` and
//! `A_m + i B_m = (x + i y)^m`, `Y_lm = K_lm Q_l^m(z) {A_m | B_m}(x, y)`.

use num_traits::Float;

use relume_layout::light::{nrsh_factor, sh_normalisation};

/// Highest SH degree of any table.
pub const MAX_SH_DEGREE: usize = 8;
const ROWS: usize = MAX_SH_DEGREE + 2;

/// `K_lm` at index `l*l + l + m` for every m >= 0, to [`MAX_SH_DEGREE`].
fn normalisations() -> &'static [f64; 81] {
    static TABLE: std::sync::LazyLock<[f64; 81]> = std::sync::LazyLock::new(|| {
        let mut table = [0.0; 81];
        for l in 0..=MAX_SH_DEGREE {
            (0..=l).for_each(|m| table[l * l + l + m] = sh_normalisation(l, m));
        }
        table
    });
    &TABLE
}

fn cast<T: Float>(v: f64) -> T {
    // Every `Float` converts from f64; the fallback satisfies the type only.
    T::from(v).unwrap_or_else(T::nan)
}

/// `Q[m][l]` for m, l <= degree + 1.
#[inline(always)]
fn legendre<T: Float>(z: T, sh_degree: usize) -> [[T; ROWS]; ROWS] {
    let mut q = [[T::zero(); ROWS]; ROWS];
    let mut diagonal = T::one();
    for m in 0..=sh_degree {
        q[m][m] = diagonal;
        if m < sh_degree {
            q[m][m + 1] = z * cast((2 * m + 1) as f64) * diagonal;
        }
        for l in m + 2..=sh_degree {
            let a = z * cast((2 * l - 1) as f64) * q[m][l - 1];
            q[m][l] = (a - cast::<T>((l + m - 1) as f64) * q[m][l - 2]) / cast((l - m) as f64);
        }
        diagonal = -diagonal * cast((2 * m + 1) as f64);
    }
    q
}

/// `A_m, B_m` for m <= degree.
#[inline(always)]
fn azimuth<T: Float>(x: T, y: T, sh_degree: usize) -> ([T; ROWS], [T; ROWS]) {
    let (mut a, mut b) = ([T::zero(); ROWS], [T::zero(); ROWS]);
    a[0] = T::one();
    for m in 1..=sh_degree {
        a[m] = x * a[m - 1] - y * b[m - 1];
        b[m] = x * b[m - 1] + y * a[m - 1];
    }
    (a, b)
}

/// Calls a function that is compiled once per degree: constant loop bounds let the compiler unroll it.
macro_rules! at_degree {
    ($sh_degree:expr, $function:ident, $($argument:expr),*) => {
        match $sh_degree {
            0 => $function::<T, 0>($($argument),*),
            1 => $function::<T, 1>($($argument),*),
            2 => $function::<T, 2>($($argument),*),
            3 => $function::<T, 3>($($argument),*),
            4 => $function::<T, 4>($($argument),*),
            5 => $function::<T, 5>($($argument),*),
            6 => $function::<T, 6>($($argument),*),
            7 => $function::<T, 7>($($argument),*),
            _ => $function::<T, MAX_SH_DEGREE>($($argument),*),
        }
    };
}

/// Values of all harmonics up to `sh_degree` (at most 8) along unit direction `d`.
///
/// `out` receives `(sh_degree + 1)^2` values; later elements are unchanged.
pub fn sh_eval<T: Float>(sh_degree: usize, d: [T; 3], out: &mut [T]) {
    at_degree!(sh_degree, values, d, out);
}

fn values<T: Float, const SH_DEGREE: usize>(d: [T; 3], out: &mut [T]) {
    let (q, (a, b)) = (legendre(d[2], SH_DEGREE), azimuth(d[0], d[1], SH_DEGREE));
    let k = normalisations();
    for l in 0..=SH_DEGREE {
        let centre = l * l + l;
        out[centre] = cast::<T>(k[centre]) * q[0][l];
        for m in 1..=l {
            let kq = cast::<T>(k[centre + m]) * q[m][l];
            out[centre + m] = kq * a[m];
            out[centre - m] = kq * b[m];
        }
    }
}

/// As [`sh_eval`], with the gradient of each harmonic as a polynomial in (x, y, z).
///
/// The radial part of the gradient is that of the polynomial, not zero: callers that normalise `d`
/// must project it out, as the chain rule through a normalisation does.
pub fn sh_eval_with_gradient<T: Float>(sh_degree: usize, d: [T; 3], out: &mut [T], gradient: &mut [[T; 3]]) {
    at_degree!(sh_degree, values_with_gradient, d, out, gradient);
}

fn values_with_gradient<T: Float, const SH_DEGREE: usize>(d: [T; 3], out: &mut [T], gradient: &mut [[T; 3]]) {
    let (q, (a, b)) = (legendre(d[2], SH_DEGREE), azimuth(d[0], d[1], SH_DEGREE));
    let k = normalisations();
    for l in 0..=SH_DEGREE {
        let centre = l * l + l;
        for m in 0..=l {
            let norm = cast::<T>(k[centre + m]);
            let kq = norm * q[m][l];
            // dQ_l^m/dz = -Q_l^{m+1}, which vanishes for m = l.
            let dq = if m < l { -norm * q[m + 1][l] } else { T::zero() };
            let (am, bm) = if m > 0 { (a[m - 1], b[m - 1]) } else { (T::zero(), T::zero()) };
            let mt = cast::<T>(m as f64);
            out[centre + m] = kq * a[m];
            gradient[centre + m] = [kq * mt * am, -kq * mt * bm, dq * a[m]];
            if m > 0 {
                out[centre - m] = kq * b[m];
                gradient[centre - m] = [kq * mt * bm, kq * mt * am, dq * b[m]];
            }
        }
    }
}

/// Normal-related SH (article Eq. 17, with the 1/pi of Eq. 16): `AO = <c, nrsh(n)>`.
pub fn nrsh<T: Float>(sh_degree: usize, normal: [T; 3], out: &mut [T]) {
    sh_eval(sh_degree, normal, out);
    for l in 0..=sh_degree {
        let factor = cast::<T>(nrsh_factor(l));
        out[l * l..(l + 1) * (l + 1)].iter_mut().for_each(|v| *v = *v * factor);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texel_directions;

    #[test]
    fn sh_basis_is_orthonormal_to_degree_six() {
        const N: usize = 49;
        let mut gram = vec![0.0f64; N * N];
        // Gauss-like accuracy from a fine equirectangular grid: the trapezoid in longitude is exact here,
        // and 4,000 rows leave 1e-6 in latitude.
        for row in 0..4000 {
            let z = (std::f64::consts::PI * (row as f64 + 0.5) / 4000.0).cos();
            let edge = |i: usize| (std::f64::consts::PI * i as f64 / 4000.0).cos();
            let weight = (edge(row) - edge(row + 1)) * std::f64::consts::TAU / 16.0;
            for column in 0..16 {
                let phi = std::f64::consts::TAU * column as f64 / 16.0;
                let s = (1.0 - z * z).sqrt();
                let mut y = [0.0; N];
                sh_eval(6, [s * phi.cos(), s * phi.sin(), z], &mut y);
                for i in 0..N {
                    (0..N).for_each(|j| gram[i * N + j] += weight * y[i] * y[j]);
                }
            }
        }
        for i in 0..N {
            for j in 0..N {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((gram[i * N + j] - expected).abs() < 1e-4, "({i},{j}) {}", gram[i * N + j]);
            }
        }
    }

    #[test]
    fn sh_gradients_agree_with_differences_even_at_the_poles() {
        for d in [[0.3, -0.5, 0.81], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]] {
            let (mut y, mut g) = ([0.0f64; 49], [[0.0; 3]; 49]);
            sh_eval_with_gradient(6, d, &mut y, &mut g);
            for axis in 0..3 {
                let (mut hi, mut lo) = ([0.0; 49], [0.0; 49]);
                let (mut dh, mut dl) = (d, d);
                dh[axis] += 1e-6;
                dl[axis] -= 1e-6;
                sh_eval(6, dh, &mut hi);
                sh_eval(6, dl, &mut lo);
                for i in 0..49 {
                    assert!((g[i][axis] - (hi[i] - lo[i]) / 2e-6).abs() < 1e-7, "{d:?} {i} {axis}");
                }
            }
        }
    }

    #[test]
    fn full_visibility_gives_ambient_occlusion_of_one() {
        for (n, _) in texel_directions(8, 4) {
            let mut r = [0.0; 25];
            nrsh(4, n.to_array(), &mut r);
            let c00 = 2.0 * std::f64::consts::PI.sqrt();
            assert!((c00 * r[0] - 1.0).abs() < 1e-14);
        }
    }
}
