//! Conversion from +Z up, as in models, to +Y up, as in glTF and USD: a quarter turn about +X of everything that has
//! a direction. This includes the colour, so that readers need not rotate spherical harmonics.

use glam::{DQuat, DVec3, Vec3};

use crate::formats::splats::{MAX_SPLAT_SH_DEGREE, Splats};
use relume_scene::light::sh_eval;
use relume_scene::sh_count;

const COUNT: usize = sh_count(MAX_SPLAT_SH_DEGREE);
/// Nodes and weights of the Gauss-Legendre rule of four points, exact up to degree 7.
const HEIGHTS: [(f64, f64); 4] = [
    (-0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
    (-0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
    (0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
    (0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
];
/// Number of directions at each of those heights.
const ROUND: usize = 8;

impl Splats {
    /// Converts +Z up to +Y up.
    #[must_use]
    pub fn with_y_up(mut self) -> Self {
        let turn = DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2);
        let turned = |v: &mut Vec3| *v = Vec3::new(v.x, v.z, -v.y);
        self.positions.iter_mut().for_each(turned);
        self.normals.iter_mut().for_each(turned);
        self.rotations.iter_mut().for_each(|q| *q = (turn * *q).normalize());
        let (matrix, count) = (sh_rotation_matrix(turn), sh_count(self.degree));
        for row in self.harmonics.chunks_exact_mut(count) {
            let before: Vec<[f32; 3]> = row.to_vec();
            for (out, weights) in row.iter_mut().zip(&matrix) {
                *out = std::array::from_fn(|c| {
                    before.iter().zip(weights).map(|(b, w)| f64::from(b[c]) * w).sum::<f64>() as f32
                });
            }
        }
        self
    }
}

/// `M[j][k] = int Y_j(w) Y_k(turn^-1 w) dw`, which maps SH coefficients to those of the rotated function, up to
/// [`MAX_SPLAT_SH_DEGREE`].
fn sh_rotation_matrix(turn: DQuat) -> [[f64; COUNT]; COUNT] {
    let mut out = [[0.0; COUNT]; COUNT];
    for (z, weight) in HEIGHTS {
        for step in 0..ROUND {
            let (sin, cos) = (std::f64::consts::TAU * step as f64 / ROUND as f64).sin_cos();
            let r = (1.0 - z * z).sqrt();
            let direction = DVec3::new(r * cos, r * sin, z);
            let (mut after, mut before) = ([0.0; COUNT], [0.0; COUNT]);
            sh_eval(MAX_SPLAT_SH_DEGREE, direction.to_array(), &mut after);
            sh_eval(MAX_SPLAT_SH_DEGREE, (turn.inverse() * direction).to_array(), &mut before);
            let area = weight * std::f64::consts::TAU / ROUND as f64;
            for (row, a) in out.iter_mut().zip(after) {
                row.iter_mut().zip(before).for_each(|(o, b)| *o += area * a * b);
            }
        }
    }
    // Rounding of entries that are exactly zero would write -0.0 and 1e-17 to files.
    out.map(|row| row.map(|v| if v.abs() < 1e-12 { 0.0 } else { v }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::splats::tests::example;
    use relume_scene::{Field, Gaussians};

    /// One Gaussian with different values in all coefficients of degree 3.
    fn colourful() -> Splats {
        let mut model = example();
        model.gaussians = Gaussians::zeroed(1, 2, 1, 3);
        model.gaussians.row_mut(Field::Quaternion, 0).copy_from_slice(&[0.8, 0.1, -0.5, 0.3]);
        let values = model.gaussians.row_mut(Field::Radiance, 0);
        values.iter_mut().enumerate().for_each(|(k, v)| *v = ((k * 37 % 23) as f32 - 11.0) * 0.1);
        Splats::of(&model)
    }

    fn colour(splats: &Splats, direction: DVec3) -> [f64; 3] {
        let mut y = [0.0; COUNT];
        sh_eval(splats.degree, direction.to_array(), &mut y);
        let terms = || splats.harmonics(0).iter().zip(y);
        std::array::from_fn(|c| terms().map(|(s, y)| f64::from(s[c]) * y).sum())
    }

    #[test]
    fn y_up_rotation_preserves_the_appearance() {
        let (before, after) = (colourful(), colourful().with_y_up());
        for direction in [DVec3::X, DVec3::Z, DVec3::new(0.6, -0.64, 0.48)] {
            let turned = DVec3::new(direction.x, direction.z, -direction.y);
            let (a, b) = (colour(&before, direction), colour(&after, turned));
            assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5), "{direction}: {a:?} {b:?}");
            let still = colour(&after, direction);
            let moved = a.iter().zip(still).any(|(a, b)| (a - b).abs() > 1e-2);
            assert!(moved || direction == DVec3::X, "the control: {direction}");
            let axis = after.rotations[0] * direction;
            let was = before.rotations[0] * direction;
            assert!((axis - DVec3::new(was.x, was.z, -was.y)).length() < 1e-12);
        }
        let p = before.positions[0];
        assert_eq!(after.positions[0], Vec3::new(p.x, p.z, -p.y));
    }
}
