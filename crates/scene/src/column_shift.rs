//! Rotation of an equirectangular environment about +Z, as a circular shift of its columns.

use std::borrow::Cow;
use std::f64::consts::TAU;

/// The column shift of a rotated environment. A texel of the rotated map interpolates two neighbours of the original map:
/// `(1 - fraction) L[x + whole] + fraction L[x + whole + 1]`, columns modulo the width.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColumnShift {
    width: usize,
    whole: usize,
    fraction: f32,
}

impl ColumnShift {
    /// The shift that rotates maps of `width` columns by `radians`, counter-clockwise seen from above.
    pub fn new(radians: f64, width: usize) -> Self {
        let columns = (radians / TAU).rem_euclid(1.0) * width as f64;
        let whole = columns.floor();
        Self { width, whole: whole as usize % width.max(1), fraction: (columns - whole) as f32 }
    }

    /// Whole columns of the shift, below the width, and its fraction of a column, 0 to 1.
    pub fn columns(&self) -> (usize, f32) {
        (self.whole, self.fraction)
    }

    /// True where the shift is 0.
    pub fn is_none(&self) -> bool {
        self.whole == 0 && self.fraction == 0.0
    }

    /// `R L`: the row-major map `texels`, rotated.
    pub fn apply<'a>(&self, texels: &'a [[f32; 3]]) -> Cow<'a, [[f32; 3]]> {
        self.mixed(texels, self.whole, self.whole + 1)
    }

    /// `R^T g`: the gradient of the original map from that of the rotated map.
    pub fn apply_transposed<'a>(&self, gradient: &'a [[f32; 3]]) -> Cow<'a, [[f32; 3]]> {
        let back = 2 * self.width - self.whole;
        self.mixed(gradient, back, back - 1)
    }

    /// For each row, the interpolation of the columns at offsets `near` and `far`.
    fn mixed<'a>(&self, texels: &'a [[f32; 3]], near: usize, far: usize) -> Cow<'a, [[f32; 3]]> {
        if self.is_none() {
            return Cow::Borrowed(texels);
        }
        let f = self.fraction;
        let row = |row: &[[f32; 3]]| -> Vec<[f32; 3]> {
            let tap = |x: usize| {
                let (a, b) = (row[(x + near) % self.width], row[(x + far) % self.width]);
                std::array::from_fn(|c| (1.0 - f) * a[c] + f * b[c])
            };
            (0..self.width).map(tap).collect()
        };
        Cow::Owned(texels.chunks_exact(self.width).flat_map(row).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{EnvMap, texel_directions};
    use relume_compare::largest_difference;

    fn map() -> EnvMap {
        EnvMap::from_fn(16, 8, |d| [d.x as f32 + 1.5, (3.0 * d.y).sin() as f32 + 1.5, d.z.abs() as f32])
    }

    #[test]
    fn column_rotation_matches_the_sampled_rotated_environment() {
        let map = map();
        for degrees in [0.0, 22.5, 90.0, 120.0, -75.0, 360.0, 1000.0f64] {
            let turned = ColumnShift::new(degrees.to_radians(), 16).apply(map.texels()).into_owned();
            let sampled = |degrees: f64| -> Vec<[f32; 3]> {
                let back = glam::DQuat::from_rotation_z(-degrees.to_radians());
                texel_directions(16, 8).into_iter().map(|(d, _)| map.sample(back * d)).collect()
            };
            let error = |degrees| largest_difference(turned.as_flattened(), sampled(degrees).as_flattened());
            assert!(error(degrees) < 1e-5, "{degrees}");
            assert!(error(degrees + 10.0) > 0.1, "the control: ten degrees show");
        }
    }

    #[test]
    fn rotation_by_whole_columns_shifts_each_row_exactly() {
        let map = map();
        let turned = ColumnShift::new(TAU * 3.0 / 16.0, 16).apply(map.texels()).into_owned();
        let mut rolled = map.texels().to_vec();
        rolled.chunks_exact_mut(16).for_each(|row| row.rotate_left(3));
        assert_eq!(turned, rolled);
        assert_ne!(turned, map.texels());
        assert!(matches!(ColumnShift::new(TAU, 16).apply(map.texels()), Cow::Borrowed(_)));
    }

    #[test]
    fn transposed_rotation_is_the_adjoint() {
        let map = map();
        let probe: Vec<[f32; 3]> =
            (0..128).map(|i| [(i % 7) as f32 - 3.0, (i % 5) as f32, (i % 11) as f32]).collect();
        let dot = |a: &[[f32; 3]], b: &[[f32; 3]]| -> f64 {
            let pairs = a.as_flattened().iter().zip(b.as_flattened());
            pairs.map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
        };
        for columns in [0.25, 3.0, 10.7] {
            let turn = ColumnShift::new(TAU * columns / 16.0, 16);
            let forward = dot(&turn.apply(map.texels()), &probe);
            let back = dot(map.texels(), &turn.apply_transposed(&probe));
            assert!((forward - back).abs() < 1e-3, "{forward} {back}");
            let wrong = dot(map.texels(), &turn.apply(&probe));
            assert!((forward - wrong).abs() > 1.0, "the control: the turn itself is not its transpose");
        }
    }
}
