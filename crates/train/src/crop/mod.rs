//! Crops the subject of photographs without masks.
//!
//! The warm-up learns everything that the photographs show. Then the Gaussians inside a region are the subject. The
//! share of every pixel that they cover becomes its mask, and the other Gaussians are removed: they count as light.
//! From then on the training is that of a capture with masks.

mod ground;
mod region;

use crate::dataset::Dataset;
use relume_engine::{TrainState, evaluation};
use relume_scene::{Camera, Field, Gaussians, Model, ShadingOptions};

pub use region::{Region, ball};

/// SH basis function of degree 0: a coefficient of `0.5 / SH0` shows white, one of `-0.5 / SH0` black.
const SH0: f32 = 0.282_094_8;
/// Opacity logit of an invisible Gaussian.
const TRANSPARENT: f32 = -30.0;
/// The fields that determine which pixels a Gaussian covers, and its colour: white inside the region, black outside.
pub const SILHOUETTE: [Field; 5] =
    [Field::Mean, Field::LogScale, Field::Quaternion, Field::OpacityLogit, Field::Radiance];
/// Shares of a pixel, covered by the subject, at which the mask starts and at which it is 1. Smaller shares are haze,
/// larger ones have gaps.
const MASK_RAMP: [f32; 2] = [0.2, 0.6];

/// The crop, with everything that is needed to compute the masks again.
#[derive(Debug, Clone, PartialEq)]
pub struct SubjectCrop {
    /// The region, in the normalised world before the crop.
    pub region: Region,
    /// The fields of [`SILHOUETTE`] of every Gaussian before the crop, with zero opacity for haze; the other fields
    /// are zero.
    pub gaussians: Gaussians,
}

impl SubjectCrop {
    /// Crops `state` to `region`: removes the Gaussians outside and transforms the rest to a world whose unit is the
    /// region's radius. `None` if fewer than `least` Gaussians lie inside.
    pub fn of(state: &mut TrainState, region: Region, least: usize) -> Option<Self> {
        let g = &state.model.gaussians;
        let inside = |i: &usize| region.contains(g, *i);
        let kept: Vec<usize> = (0..g.len()).filter(inside).collect();
        if kept.len() < least {
            return None;
        }
        let mut silhouette = Gaussians::zeroed(g.len(), 1, 0, 0);
        for field in SILHOUETTE.into_iter().filter(|field| *field != Field::Radiance) {
            silhouette.field_mut(field).copy_from_slice(g.field(field));
        }
        silhouette.field_mut(Field::Radiance).fill(-0.5 / SH0);
        kept.iter().for_each(|i| silhouette.row_mut(Field::Radiance, *i).fill(0.5 / SH0));
        for i in (0..g.len()).filter(|i| region.is_oversized(g, *i)) {
            silhouette.row_mut(Field::OpacityLogit, i).fill(TRANSPARENT);
        }
        state.select(&kept);
        region.normalise(state);
        // The subject now fills the unit ball, so the default view applies.
        state.model.framing = None;
        Some(Self { region, gaussians: silhouette })
    }

    /// Restricts the photographs to the subject, with masks, in the world after the crop.
    pub fn apply(&self, data: &mut Dataset, shading: ShadingOptions) {
        let state = self.state(shading);
        let mask = |camera: &Camera| -> Vec<f32> {
            let covered = evaluation::radiance(&state, camera, [0.0; 3]);
            covered.iter().map(|share| opacity(share[0])).collect()
        };
        data.cut_out(self.region.world(), mask);
    }

    fn state(&self, shading: ShadingOptions) -> TrainState {
        TrainState::new(Model {
            shading,
            ..Model::new(self.gaussians.clone(), vec![[0.5; 3]], vec![[0.0; 3]; 8], (4, 2))
        })
    }
}

/// The mask value of a pixel of which the subject covers `share`.
fn opacity(share: f32) -> f32 {
    let t = ((share - MASK_RAMP[0]) / (MASK_RAMP[1] - MASK_RAMP[0])).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
