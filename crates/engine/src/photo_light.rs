//! The light of each photograph: its light group, and its rotation about +Z, as on a turntable.

use std::f64::consts::TAU;

/// Maximum number of rotations for which gathered light is measured.
pub const MAX_LIGHT_ROTATIONS: usize = 16;

/// The light of a light group, rotated.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TurnedLight {
    /// Index of the light group, which selects the environment of the model.
    pub group: usize,
    /// Rotation of the environment about +Z, radians counter-clockwise seen from above.
    pub radians: f64,
}

/// Light of one photograph.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PhotoLight {
    /// The light, with the exact rotation.
    pub light: TurnedLight,
    /// Block of gathered light that belongs to it: an index into [`PhotoLights::blocks`].
    pub block: usize,
}

/// The lights under which gathered light is measured.
#[derive(Debug, Clone, PartialEq)]
pub struct PhotoLights {
    /// Different lights, by light group and then by rotation, radians in `[0, 2 pi)`; never empty.
    pub blocks: Vec<TurnedLight>,
    /// Share of the photographs per block; the shares add up to 1.
    pub shares: Vec<f32>,
}

impl Default for PhotoLights {
    /// One light group without rotation.
    fn default() -> Self {
        Self { blocks: vec![TurnedLight::default()], shares: vec![1.0] }
    }
}

impl PhotoLights {
    /// True where the light rotates between photographs of a light group.
    pub fn has_rotations(&self) -> bool {
        self.blocks.windows(2).any(|pair| pair[0].group == pair[1].group)
    }

    /// True where the light of every photograph has rotation 0.
    pub fn is_static(&self) -> bool {
        self.blocks.iter().all(|light| light.radians == 0.0)
    }

    /// Number of light groups.
    pub fn groups(&self) -> usize {
        self.blocks.last().map_or(1, |light| light.group + 1)
    }

    /// Share of the photographs in each light group; the shares add up to 1.
    pub fn group_shares(&self) -> Vec<f32> {
        let mut shares = vec![0.0; self.groups()];
        self.blocks.iter().zip(&self.shares).for_each(|(light, share)| shares[light.group] += share);
        shares
    }

    /// The lights of photographs, given the light group of each and the rotation of its light in degrees, and the light of each
    /// photograph. Above `MAX_LIGHT_ROTATIONS` different lights, gathered light is measured at multiples of 1/16 of a full turn.
    pub fn of(photographs: &[(usize, f64)]) -> (Self, Vec<PhotoLight>) {
        let turned = |&(group, degrees): &(usize, f64)| TurnedLight {
            group,
            radians: degrees.rem_euclid(360.0).to_radians(),
        };
        let lights: Vec<TurnedLight> = photographs.iter().map(turned).collect();
        if lights.is_empty() {
            return (Self::default(), Vec::new());
        }
        let mut near = lights.clone();
        let mut blocks = different(&near);
        if blocks.len() > MAX_LIGHT_ROTATIONS {
            let step = TAU / MAX_LIGHT_ROTATIONS as f64;
            for light in &mut near {
                light.radians = (light.radians / step).round() % MAX_LIGHT_ROTATIONS as f64 * step;
            }
            blocks = different(&near);
        }
        let block = |near: &TurnedLight| blocks.partition_point(|block| order(block, near).is_lt());
        let photo =
            |(light, near): (&TurnedLight, &TurnedLight)| PhotoLight { light: *light, block: block(near) };
        let photos: Vec<PhotoLight> = lights.iter().zip(&near).map(photo).collect();
        let share = |block| photos.iter().filter(|p| p.block == block).count() as f32 / photos.len() as f32;
        let shares = (0..blocks.len()).map(share).collect();
        (Self { blocks, shares }, photos)
    }
}

/// By light group, then by rotation.
fn order(a: &TurnedLight, b: &TurnedLight) -> std::cmp::Ordering {
    a.group.cmp(&b.group).then(a.radians.total_cmp(&b.radians))
}

/// The different lights among `lights`, in order.
fn different(lights: &[TurnedLight]) -> Vec<TurnedLight> {
    let mut blocks = lights.to_vec();
    blocks.sort_by(order);
    blocks.dedup();
    blocks
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turns(degrees: &[f64]) -> (PhotoLights, Vec<PhotoLight>) {
        PhotoLights::of(&degrees.iter().map(|d| (0, *d)).collect::<Vec<_>>())
    }

    #[test]
    fn few_light_rotations_are_kept_exactly() {
        let (lights, photos) = turns(&[120.0, 0.0, -240.0, 360.0, 45.0, 0.0]);
        let radians: Vec<f64> = lights.blocks.iter().map(|light| light.radians).collect();
        assert_eq!(radians, [0.0, 45f64.to_radians(), 120f64.to_radians()]);
        assert_eq!(photos.iter().map(|p| p.block).collect::<Vec<_>>(), [2, 0, 2, 0, 1, 0]);
        assert_eq!(lights.shares, [0.5, 1.0 / 6.0, 1.0 / 3.0]);
        assert_eq!(photos[2].light.radians, 120f64.to_radians());
        assert!(lights.has_rotations() && !lights.is_static());
        assert_eq!(turns(&[0.0; 4]).0, PhotoLights::default());
        assert!(PhotoLights::default().is_static() && !PhotoLights::default().has_rotations());
        assert!(!turns(&[30.0; 4]).0.is_static(), "all turned alike are turned");
    }

    #[test]
    fn many_light_rotations_share_blocks_and_keep_their_angle() {
        let degrees: Vec<f64> = (0..72).map(|i| 5.0 * f64::from(i)).collect();
        let (lights, photos) = turns(&degrees);
        assert_eq!(lights.blocks.len(), MAX_LIGHT_ROTATIONS);
        assert!((lights.shares.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        for (degrees, photo) in degrees.iter().zip(&photos) {
            assert_eq!(photo.light.radians, degrees.to_radians());
            let off = (photo.light.radians - lights.blocks[photo.block].radians).rem_euclid(TAU);
            assert!(off.min(TAU - off) <= TAU / 32.0 + 1e-9, "{degrees}");
        }
        assert_eq!(photos[71].block, 0, "355 degrees are next to 0");
    }

    #[test]
    fn light_groups_have_blocks_of_their_own() {
        let (lights, photos) = PhotoLights::of(&[(1, 0.0), (0, 0.0), (1, 0.0), (1, 0.0)]);
        assert_eq!(photos.iter().map(|p| p.block).collect::<Vec<_>>(), [1, 0, 1, 1]);
        assert_eq!((lights.groups(), lights.group_shares()), (2, vec![0.25, 0.75]));
        assert!(lights.is_static() && !lights.has_rotations());
        let (both, _) = PhotoLights::of(&[(0, 0.0), (1, 0.0), (1, 30.0)]);
        assert!(both.has_rotations() && !both.is_static(), "the control");
        assert_eq!(both.group_shares().len(), 2);
    }
}
