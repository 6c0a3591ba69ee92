//! The light of a photograph against the light of the model: turned about +Z, as on a turntable.

use std::f64::consts::TAU;

/// Most turns that gathered light is measured for.
pub const MAX_LIGHT_ROTATIONS: usize = 16;

/// How the light stood in one photograph.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LightRotation {
    /// Turn of the environment about +Z, radians counter-clockwise seen from above.
    pub radians: f64,
    /// Which of the measured blocks of gathered light belongs to it: an index into [`LightRotations::blocks`].
    pub block: usize,
}

/// The turns that gathered light is measured for.
#[derive(Debug, Clone, PartialEq)]
pub struct LightRotations {
    /// Turns, radians in `[0, 2 pi)`, in order; never empty.
    pub blocks: Vec<f64>,
    /// Share of the photographs that each stands for; they add up to 1.
    pub shares: Vec<f32>,
}

impl Default for LightRotations {
    /// A light that stands still.
    fn default() -> Self {
        Self { blocks: vec![0.0], shares: vec![1.0] }
    }
}

impl LightRotations {
    /// True where the light turns between photographs.
    pub fn has_rotations(&self) -> bool {
        self.blocks.len() > 1
    }

    /// True where no photograph's light is turned against the model's.
    pub fn is_static(&self) -> bool {
        self.blocks == [0.0]
    }

    /// The turns of photographs whose light is turned by `degrees`, and each photograph's place among them. Beyond
    /// [`MAX_LIGHT_ROTATIONS`] different ones, gathered light is measured at multiples of a sixteenth of a full turn.
    pub fn of(degrees: &[f64]) -> (Self, Vec<LightRotation>) {
        let radians: Vec<f64> = degrees.iter().map(|d| d.rem_euclid(360.0).to_radians()).collect();
        let mut stands: Vec<f64> = radians.clone();
        let different = |rotations: &mut Vec<f64>| {
            rotations.sort_by(f64::total_cmp);
            rotations.dedup();
        };
        let mut blocks = stands.clone();
        different(&mut blocks);
        if blocks.len() > MAX_LIGHT_ROTATIONS {
            let step = TAU / MAX_LIGHT_ROTATIONS as f64;
            let near = |turn: &f64| (turn / step).round() % MAX_LIGHT_ROTATIONS as f64 * step;
            stands = radians.iter().map(near).collect();
            blocks.clone_from(&stands);
            different(&mut blocks);
        }
        let place = |(radians, stand): (&f64, &f64)| LightRotation {
            radians: *radians,
            block: blocks.partition_point(|block| block < stand),
        };
        let rotations: Vec<LightRotation> = radians.iter().zip(&stands).map(place).collect();
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
