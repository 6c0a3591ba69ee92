//! Cuts the subject out of photographs without masks.
//!
//! The warm-up learns everything that the photographs show. Then the Gaussians inside a region are the subject. The share of
//! every pixel that they cover is its mask from then on, and the rest is forgotten: it is light. So a capture without masks becomes
//! one with masks, and all that holds for those holds for it.

mod ground;
mod region;

use glam::DVec3;

use crate::dataset::Dataset;
use relume_engine::TrainState;
use relume_engine::cpu::evaluation;
use relume_scene::{Camera, Field, Gaussians, LightSplit, Model, ShadingOptions};

pub use region::Region;

/// Zeroth basis function of spherical harmonics: a coefficient of `0.5 / SH0` shows white, one of `-0.5 / SH0` black.
const SH0: f32 = 0.282_094_8;
/// Opacity logit of what hides nothing.
const TRANSPARENT: f32 = -30.0;
/// What of a Gaussian decides which pixels it covers, and its colour: white inside the region, black outside.
pub const SILHOUETTE: [Field; 5] =
    [Field::Mean, Field::LogScale, Field::Quaternion, Field::OpacityLogit, Field::Radiance];
/// Share of a pixel that the subject covers at which its mask begins and is whole: below is haze, above are gaps.
const MASK_RAMP: [f32; 2] = [0.2, 0.6];

/// What was cut out, and all that is needed to make the masks again.
#[derive(Debug, Clone, PartialEq)]
pub struct SubjectCrop {
    /// The region, in the normalised world before the cut.
    pub region: Region,
    /// The fields of [`SILHOUETTE`] of every Gaussian before the cut, haze without opacity; the others are zero.
    pub gaussians: Gaussians,
}

impl SubjectCrop {
    /// Cuts `state` along `region`: the Gaussians outside go, and the rest is brought to a world whose unit is the region's radius.
    /// `None` where fewer than `least` Gaussians lie inside.
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
        // The subject lies in the unit ball now, and nothing hides it.
        state.model.framing = None;
        Some(Self { region, gaussians: silhouette })
    }

    /// Makes the photographs those of the subject alone, with masks, in the world after the cut.
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
            gaussians: self.gaussians.clone(),
            prototypes: vec![[0.5; 3]],
            env_raw: vec![[0.0; 3]; 8],
            env_width: 4,
            env_height: 2,
            lights: LightSplit::default(),
            shading,
            world_scale: 1.0,
            world_offset: DVec3::ZERO,
            framing: None,
            card: serde_json::Value::Null,
        })
    }
}

/// The mask of a pixel that the subject covers by `share`.
fn opacity(share: f32) -> f32 {
    let t = ((share - MASK_RAMP[0]) / (MASK_RAMP[1] - MASK_RAMP[0])).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
