//! A seamless cube grid over directions, with bilinear look-up.
//!
//! Nodes lie *on* the cube's edges, so two faces share the directions of their common edge and a table is continuous over
//! the whole sphere. A look-up needs no trigonometry and has no pole and no seam.

use glam::DVec3;
use num_traits::Float;

/// `6 n^2` directions, `n >= 2` nodes along a cube edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CubeGrid {
    n: usize,
}

/// The four nodes around a direction, their weights (summing to 1) and the weights' gradients.
#[derive(Debug, Clone, Copy)]
pub struct Taps<T> {
    /// Node indices.
    pub node: [usize; 4],
    /// Bilinear weights.
    pub weight: [T; 4],
    /// Gradient of each weight with respect to the (not necessarily unit) direction.
    pub gradient: [[T; 3]; 4],
}

impl CubeGrid {
    /// A grid with `n` nodes along an edge; at least 2.
    pub fn new(n: usize) -> Self {
        Self { n: n.max(2) }
    }

    /// Nodes along a cube edge.
    pub fn edge(&self) -> usize {
        self.n
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        6 * self.n * self.n
    }

    /// Never true; for symmetry with `len`.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// Unit direction of each node, in index order.
    pub fn directions(&self) -> Vec<DVec3> {
        let step = 2.0 / (self.n - 1) as f64;
        let mut out = Vec::with_capacity(self.len());
        for face in 0..6 {
            let sign = if face % 2 == 0 { 1.0 } else { -1.0 };
            for t in 0..self.n {
                for s in 0..self.n {
                    let mut d = [0.0; 3];
                    d[face / 2] = sign;
                    d[(face / 2 + 1) % 3] = -1.0 + step * s as f64;
                    d[(face / 2 + 2) % 3] = -1.0 + step * t as f64;
                    out.push(DVec3::from_array(d).normalize());
                }
            }
        }
        out
    }

    /// The nodes and weights around direction `d`, of any positive length.
    #[inline]
    pub fn lookup<T: Float>(&self, d: [T; 3]) -> Taps<T> {
        let magnitude = [d[0].abs(), d[1].abs(), d[2].abs()];
        let axis = if magnitude[0] >= magnitude[1] && magnitude[0] >= magnitude[2] {
            0
        } else if magnitude[1] >= magnitude[2] {
            1
        } else {
            2
        };
        let (us, ut) = ((axis + 1) % 3, (axis + 2) % 3);
        let one = T::one();
        // A zero direction maps to node 0 with zero derivatives.
        let length = magnitude[axis];
        let inverse = if length > T::min_positive_value() { one / length } else { T::zero() };
        let (s, t) = (d[us] * inverse, d[ut] * inverse);
        let face = 2 * axis + usize::from(d[axis] < T::zero());
        let half = T::from(self.n - 1).unwrap_or(one) / (one + one);
        let cell = |v: T| -> (usize, T) {
            let x = ((v + one) * half).max(T::zero());
            let i = x.floor().to_usize().unwrap_or(0).min(self.n - 2);
            (i, (x - T::from(i).unwrap_or(one)).min(one))
        };
        let ((i, fs), (j, ft)) = (cell(s), cell(t));
        let base = (face * self.n + j) * self.n + i;
        let (gs, gt) = (one - fs, one - ft);
        // Derivatives of the two face coordinates with respect to d.
        let sign = if d[axis] < T::zero() { -one } else { one };
        let along = |coordinate: T, u: usize| {
            let mut g = [T::zero(); 3];
            g[u] = half * inverse;
            g[axis] = -coordinate * half * inverse * sign;
            g
        };
        let (ds, dt) = (along(s, us), along(t, ut));
        let mix = |a: T, b: T| std::array::from_fn(|k| a * ds[k] + b * dt[k]);
        Taps {
            node: [base, base + 1, base + self.n, base + self.n + 1],
            weight: [gs * gt, fs * gt, gs * ft, fs * ft],
            gradient: [mix(-gt, -gs), mix(gt, -fs), mix(-ft, gs), mix(ft, fs)],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_compare::worst;

    fn interpolate(grid: &CubeGrid, values: &[f64], d: DVec3) -> f64 {
        let taps = grid.lookup(d.to_array());
        (0..4).map(|k| taps.weight[k] * values[taps.node[k]]).sum()
    }

    #[test]
    fn interpolation_error_is_small_and_falls_with_grid_size() {
        let f = |d: DVec3| (d.x * 2.0 + d.y).sin() + d.z * d.z;
        let error = |n: usize| {
            let grid = CubeGrid::new(n);
            let values: Vec<f64> = grid.directions().into_iter().map(f).collect();
            let dirs = crate::texel_directions(40, 20);
            worst(dirs.into_iter().map(|(d, _)| (interpolate(&grid, &values, d) - f(d)).abs()))
        };
        assert!(error(9) < 0.05 && error(33) < error(9) / 8.0, "{} {}", error(9), error(33));
    }

    #[test]
    fn interpolation_is_continuous_across_edges_and_corners() {
        let grid = CubeGrid::new(5);
        let values: Vec<f64> = grid.directions().iter().map(|d| d.x + 2.0 * d.y - d.z).collect();
        for centre in [DVec3::new(1.0, 1.0, 0.2), DVec3::new(-1.0, -1.0, -1.0), DVec3::new(0.4, 1.0, -1.0)] {
            let around = [DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_X, DVec3::NEG_Y, DVec3::NEG_Z];
            let seen = around.map(|o| interpolate(&grid, &values, centre + o * 1e-7));
            let (lo, hi) =
                (seen.iter().copied().fold(9.0, f64::min), seen.iter().copied().fold(-9.0, f64::max));
            assert!(hi - lo < 1e-5, "{centre} {seen:?}");
        }
    }

    #[test]
    fn weight_gradients_agree_with_central_differences() {
        let grid = CubeGrid::new(7);
        for d in [[0.31, -0.9, 0.41], [-0.8, 0.1, 0.33], [0.2, 0.1, -0.7]] {
            let taps = grid.lookup(d);
            for axis in 0..3 {
                let (mut hi, mut lo) = (d, d);
                hi[axis] += 1e-7;
                lo[axis] -= 1e-7;
                let (hi, lo) = (grid.lookup(hi), grid.lookup(lo));
                for k in 0..4 {
                    let numeric = (hi.weight[k] - lo.weight[k]) / 2e-7;
                    assert!((taps.gradient[k][axis] - numeric).abs() < 1e-5, "{d:?} {k} {axis}");
                }
            }
        }
    }
}
