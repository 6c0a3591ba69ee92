//! Rotation of a photograph's light about +Z relative to the model's light, as on a turntable.

use std::f64::consts::TAU;

/// Maximum number of rotations for which gathered light is measured.
pub const MAX_LIGHT_ROTATIONS: usize = 16;

/// Rotation of the light in one photograph.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LightRotation {
    /// Rotation of the environment about +Z, radians counter-clockwise seen from above.
    pub radians: f64,
    /// Block of gathered light that belongs to it: an index into [`LightRotations::blocks`].
    pub block: usize,
}

/// The rotations for which gathered light is measured.
#[derive(Debug, Clone, PartialEq)]
pub struct LightRotations {
    /// Rotations, radians in `[0, 2 pi)`, ascending; never empty.
    pub blocks: Vec<f64>,
    /// Share of the photographs per rotation; the shares add up to 1.
    pub shares: Vec<f32>,
}

impl Default for LightRotations {
    /// One rotation of 0.
    fn default() -> Self {
        Self { blocks: vec![0.0], shares: vec![1.0] }
    }
}

impl LightRotations {
    /// True where the light rotates between photographs.
    pub fn has_rotations(&self) -> bool {
        self.blocks.len() > 1
    }

    /// True where the light of every photograph has rotation 0.
    pub fn is_static(&self) -> bool {
        self.blocks == [0.0]
    }

    /// The rotations of photographs whose light is rotated by `degrees`, and the block of each photograph. Above
    /// `MAX_LIGHT_ROTATIONS` different rotations, gathered light is measured at multiples of 1/16 of a full turn.
    pub fn of(degrees: &[f64]) -> (Self, Vec<LightRotation>) {
        let radians: Vec<f64> = degrees.iter().map(|d| d.rem_euclid(360.0).to_radians()).collect();
        let mut grouped: Vec<f64> = radians.clone();
        let different = |rotations: &mut Vec<f64>| {
            rotations.sort_by(f64::total_cmp);
            rotations.dedup();
        };
        let mut blocks = grouped.clone();
        different(&mut blocks);
        if blocks.len() > MAX_LIGHT_ROTATIONS {
            let step = TAU / MAX_LIGHT_ROTATIONS as f64;
            let near = |turn: &f64| (turn / step).round() % MAX_LIGHT_ROTATIONS as f64 * step;
            grouped = radians.iter().map(near).collect();
            blocks.clone_from(&grouped);
            different(&mut blocks);
        }
        let rotation = |(radians, group): (&f64, &f64)| LightRotation {
            radians: *radians,
            block: blocks.partition_point(|block| block < group),
        };
        let rotations: Vec<LightRotation> = radians.iter().zip(&grouped).map(rotation).collect();
        if rotations.is_empty() {
            return (Self::default(), rotations);
        }
        let share =
            |block| rotations.iter().filter(|t| t.block == block).count() as f32 / rotations.len() as f32;
        let shares = (0..blocks.len()).map(share).collect();
        (Self { blocks, shares }, rotations)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_light_rotations_are_kept_exactly() {
        let (rotations, photos) = LightRotations::of(&[120.0, 0.0, -240.0, 360.0, 45.0, 0.0]);
        assert_eq!(rotations.blocks, [0.0, 45f64.to_radians(), 120f64.to_radians()]);
        assert_eq!(photos.iter().map(|p| p.block).collect::<Vec<_>>(), [2, 0, 2, 0, 1, 0]);
        assert_eq!(rotations.shares, [0.5, 1.0 / 6.0, 1.0 / 3.0]);
        assert_eq!(photos[2].radians, 120f64.to_radians());
        assert_eq!(LightRotations::of(&[0.0; 4]).0, LightRotations::default());
        assert!(LightRotations::default().is_static());
        assert!(!LightRotations::of(&[30.0; 4]).0.is_static(), "all turned alike are turned");
    }

    #[test]
    fn many_light_rotations_share_blocks_and_keep_their_angle() {
        let degrees: Vec<f64> = (0..72).map(|i| 5.0 * f64::from(i)).collect();
        let (rotations, photos) = LightRotations::of(&degrees);
        assert_eq!(rotations.blocks.len(), MAX_LIGHT_ROTATIONS);
        assert!((rotations.shares.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        for (degrees, photo) in degrees.iter().zip(&photos) {
            assert_eq!(photo.radians, degrees.to_radians());
            let off = (photo.radians - rotations.blocks[photo.block]).rem_euclid(TAU);
            assert!(off.min(TAU - off) <= TAU / 32.0 + 1e-9, "{degrees}");
        }
        assert_eq!(photos[71].block, 0, "355 degrees are next to 0");
    }
}
