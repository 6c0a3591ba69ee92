//! The light of lamps on the ground below a model (docs/MODEL.md, section 9).

use std::f32::consts::PI;

use crate::render::lamps::normalised;
use relume_engine::{Ground, Lamp as EngineLamp, LampGround, LampLight};
use relume_scene::Model;
use relume_spec::rendering::Lamp;

/// Rays of one step.
const STEP_RAYS: usize = 1 << 19;

/// The light of lamps on points of the ground, computed in steps of a fraction of a second.
pub(super) struct LampsOnGround {
    lamps: Vec<EngineLamp>,
    ground: LampGround,
    sums: Vec<LampLight>,
    /// The lamp and the point that come next.
    lamp: usize,
    point: usize,
}

impl LampsOnGround {
    /// Prepares the light of `lamps` on `points` points of `ground` below `model`.
    pub(super) fn new(lamps: &[Lamp], model: &Model, ground: &Ground, points: usize) -> Self {
        Self {
            lamps: lamps.iter().map(|lamp| normalised(lamp, model)).collect(),
            ground: ground.for_lamps(),
            sums: vec![LampLight::default(); points],
            lamp: 0,
            point: 0,
        }
    }

    /// Computes the light of a lamp on some of the `points` of the ground, normalised world. Returns false when all lamps are done.
    pub(super) fn step(&mut self, points: &[[f32; 3]]) -> bool {
        let Some(lamp) = self.lamps.get(self.lamp) else { return false };
        let count = (STEP_RAYS / lamp.points.len().max(1)).max(1);
        let group = self.point..(self.point + count).min(points.len());
        self.ground.add(&mut self.sums[group.clone()], &points[group.clone()], lamp);
        self.point = group.end;
        if self.point >= points.len() {
            (self.lamp, self.point) = (self.lamp + 1, 0);
        }
        self.lamp < self.lamps.len()
    }

    /// For each point, the radiance of a white diffuse surface, and the share of the light that passes the model: 1 in channels without light.
    pub(super) fn light_and_shadow(&self) -> impl Iterator<Item = [[f32; 3]; 2]> + '_ {
        self.sums.iter().map(|LampLight { open, received }| {
            let share = |c: usize| if open[c] > 0.0 { received[c] / open[c] } else { 1.0 };
            [received.map(|v| v / PI), std::array::from_fn(share)]
        })
    }
}
