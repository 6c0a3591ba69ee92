//! The region of a crop.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::crop::ground;
use crate::dataset::Dataset;
use relume_engine::{PhotoSize, TrainState};
use relume_scene::{Field, Gaussians};
use relume_spec::training::{Crop, NamedCrop};

/// Standard deviation from which a Gaussian is haze that represents the surroundings, ball radii.
const MAX_SUBJECT_SCALE: f64 = 0.2;

/// A ball above the ground, in the normalised world of the training before the crop.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Region {
    /// Centre of the ball.
    pub centre: [f64; 3],
    /// Radius of the ball.
    pub radius: f64,
    /// Upward unit normal of the ground and its height along it; points below are outside.
    pub ground: Option<[f64; 4]>,
}

/// Centre and radius of the ball that `crop` specifies, in the normalised world; `None` without a crop.
pub fn ball(crop: Crop, data: &Dataset) -> Option<(DVec3, f64)> {
    match crop {
        Crop::Named(NamedCrop::None) => None,
        Crop::Named(NamedCrop::Auto) => Some(relume_capture::focus_region(&data.cameras(PhotoSize::Full))),
        Crop::Ball([x, y, z, radius]) => {
            Some(((DVec3::new(x, y, z) + data.offset) * data.scale, radius * data.scale))
        }
    }
}

impl Region {
    /// The region that `crop` specifies; `None` without a crop.
    pub fn of(crop: Crop, state: &TrainState, data: &Dataset) -> Option<Self> {
        let (centre, radius) = ball(crop, data)?;
        let finds_ground = crop == Crop::Named(NamedCrop::Auto);
        let ground = finds_ground
            .then(|| ground::find(state, &data.cameras(PhotoSize::Half), centre, radius))
            .flatten();
        Some(Self { centre: centre.to_array(), radius, ground })
    }

    /// Whether Gaussian `i` of `g` lies inside and is not haze.
    pub fn contains(&self, g: &Gaussians, i: usize) -> bool {
        let p = DVec3::from_array(std::array::from_fn(|k| f64::from(g.row(Field::Mean, i)[k])));
        let above = self.ground.is_none_or(|[x, y, z, height]| DVec3::new(x, y, z).dot(p) > height);
        above && !self.is_oversized(g, i) && (p - DVec3::from(self.centre)).length() < self.radius
    }

    /// Whether Gaussian `i` of `g` is too large to belong to the subject or to an object in front of it.
    pub fn is_oversized(&self, g: &Gaussians, i: usize) -> bool {
        let largest = g.row(Field::LogScale, i).iter().fold(f32::NEG_INFINITY, |most, s| most.max(*s));
        f64::from(largest).exp() >= MAX_SUBJECT_SCALE * self.radius
    }

    /// Scale and offset to the world after the crop, `x' = scale * (x + offset)`: the ball becomes the unit ball.
    pub fn world(&self) -> (f64, DVec3) {
        (1.0 / self.radius, -DVec3::from(self.centre))
    }

    /// Transforms a state to the world after the crop.
    pub fn normalise(&self, state: &mut TrainState) {
        let (scale, offset) = self.world();
        let model = &mut state.model;
        for mean in model.gaussians.field_mut(Field::Mean).as_chunks_mut::<3>().0 {
            (0..3).for_each(|k| mean[k] = ((f64::from(mean[k]) + offset[k]) * scale) as f32);
        }
        model.gaussians.field_mut(Field::LogScale).iter_mut().for_each(|s| *s += scale.ln() as f32);
        // Gradients by position are inversely proportional to the scale.
        state.moments.first.field_mut(Field::Mean).iter_mut().for_each(|m| *m /= scale as f32);
        state.moments.second.field_mut(Field::Mean).iter_mut().for_each(|m| *m /= (scale * scale) as f32);
        model.world_offset += offset / model.world_scale;
        model.world_scale *= scale;
    }
}
