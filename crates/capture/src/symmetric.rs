//! Eigenvalues of symmetric 3 x 3 matrices, for second moments of directions and points.

use glam::{DMat3, DVec3};

/// Number of sweeps over the three off-diagonal elements. Jacobi's method converges quadratically; six sweeps reach the precision
/// of 64-bit floats.
const SWEEPS: usize = 12;

/// Eigenvalues in ascending order, and the unit eigenvector of each.
pub(super) struct Eigen {
    pub values: [f64; 3],
    pub vectors: [DVec3; 3],
}

/// The eigenvalues of a symmetric matrix, by Jacobi's method. Elements that are not finite give values that are not finite.
pub(super) fn eigen(matrix: DMat3) -> Eigen {
    let mut a = matrix.to_cols_array_2d();
    let mut v = DMat3::IDENTITY.to_cols_array_2d();
    for (p, q) in [(0, 1), (0, 2), (1, 2)].into_iter().cycle().take(3 * SWEEPS) {
        if a[p][q] == 0.0 || !a[p][q].is_finite() {
            continue;
        }
        // The rotation in the plane of axes p and q that makes the element zero.
        let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
        let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
        let c = 1.0 / t.hypot(1.0);
        let s = t * c;
        for column in &mut a {
            (column[p], column[q]) = (c * column[p] - s * column[q], s * column[p] + c * column[q]);
        }
        for k in 0..3 {
            (a[p][k], a[q][k]) = (c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]);
            (v[p][k], v[q][k]) = (c * v[p][k] - s * v[q][k], s * v[p][k] + c * v[q][k]);
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| a[i][i].total_cmp(&a[j][j]));
    Eigen {
        values: order.map(|i| a[i][i]),
        vectors: order.map(|i| DVec3::from_array(v[i]).normalize_or_zero()),
    }
}

/// The matrix with the products of the components of `v`.
pub(super) fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    #[test]
    fn eigenvectors_of_a_rotated_diagonal_are_found() {
        for (x, y, z) in [(0.3, -1.2, 0.7), (0.0, 0.0, 0.0), (2.0, 0.1, -3.0)] {
            let turn = DMat3::from_quat(DQuat::from_euler(glam::EulerRot::XYZ, x, y, z));
            let found = eigen(turn * DMat3::from_diagonal(DVec3::new(2.0, 0.001, 0.5)) * turn.transpose());
            for (value, (wanted, axis)) in found.values.iter().zip([(0.001, 1), (0.5, 2), (2.0, 0)]) {
                assert!((value - wanted).abs() < 1e-12, "{value} {wanted}");
                let vector = found.vectors[found.values.iter().position(|v| v == value).unwrap()];
                assert!(vector.dot(turn.col(axis)).abs() > 1.0 - 1e-12, "{vector}");
            }
        }
        let equal = eigen(DMat3::IDENTITY);
        assert_eq!(equal.values, [1.0; 3]);
        assert!(eigen(DMat3::from_cols_array(&[f64::NAN; 9])).values[0].is_nan());
    }
}
