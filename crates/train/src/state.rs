//! Position of a training in its schedule.

use std::sync::Arc;

use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::complexity::state::ComplexityState;
use crate::crop::SubjectCrop;
use crate::dataset::Gain;
use crate::surroundings::SurroundingLight;
use crate::time_budget::{BudgetState, Timeline};
use relume_capture::WorldUp;
use relume_scene::light::LightColour;

/// Position of a training in its schedule; kept on the host for every device.
#[derive(Debug, Clone, PartialEq)]
pub struct ScheduleState {
    /// Completed steps.
    pub step: u32,
    /// Order of the photographs in this epoch.
    pub order: Vec<u32>,
    /// Position in `order`.
    pub cursor: u32,
    /// Source of all random choices.
    pub rng: ChaCha8Rng,
    /// Factor on all step sizes, lowered after a roll-back.
    pub rate_factor: f32,
    /// Seconds spent in steps.
    pub seconds: f64,
    /// Decisions about the model's size so far.
    pub complexity: ComplexityState,
    /// Colour of the light when the materials were initialised; `None` before.
    pub light_colour: Option<LightColour>,
    /// Gains by which the photographs were divided, one list per correction; empty for constant exposure.
    pub gains: Vec<Vec<Gain>>,
    /// For each strong small light, the share by which sharp shadows explain the photographs better than soft ones.
    pub lights: Vec<f32>,
    /// The light of the surroundings, once materials train; `None` where the photographs do not determine it.
    pub surroundings: Option<Arc<SurroundingLight>>,
    /// The direction in the files of the capture that is +Z of the model.
    pub up: Option<WorldUp>,
    /// The crop of the subject of photographs without masks, after the warm-up.
    pub cut: Option<Arc<SubjectCrop>>,
    /// Position of each step in the schedule.
    pub timeline: Timeline,
    /// Time budget, if the training has one.
    pub budget: Option<BudgetState>,
}

impl ScheduleState {
    /// The start of a training of `iterations` steps on `photographs` photographs; the first epoch draws their order.
    pub fn new(photographs: usize, iterations: u32, rng: ChaCha8Rng) -> Self {
        Self {
            step: 0,
            order: (0..photographs as u32).collect(),
            cursor: photographs as u32,
            rng,
            rate_factor: 1.0,
            seconds: 0.0,
            complexity: ComplexityState::default(),
            light_colour: None,
            gains: Vec::new(),
            lights: Vec::new(),
            surroundings: None,
            up: None,
            cut: None,
            timeline: Timeline::new(iterations),
            budget: None,
        }
    }

    /// Number of times that the photographs were modified.
    pub fn revision(&self) -> usize {
        self.gains.len() + usize::from(self.cut.is_some())
    }

    /// Position in the schedule.
    pub fn position(&self) -> u32 {
        self.timeline.position(self.step)
    }

    /// Advances to the photograph of the next step. Each epoch visits all photographs in a new order.
    pub fn next_photo(&mut self) -> usize {
        if self.cursor as usize >= self.order.len() {
            self.order.shuffle(&mut self.rng);
            self.cursor = 0;
        }
        self.cursor += 1;
        self.order[self.cursor as usize - 1] as usize
    }

    /// The photographs of the next `count` steps, without advancing.
    pub fn next_photos(&self, count: usize) -> Vec<usize> {
        let at = self.cursor as usize;
        if let Some(next) = self.order.get(at..at + count) {
            return next.iter().map(|i| *i as usize).collect();
        }
        let mut ahead = self.clone();
        (0..count).map(|_| ahead.next_photo()).collect()
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn next_photographs_are_known_beyond_the_end_of_an_epoch() {
        let mut schedule = ScheduleState::new(5, 100, ChaCha8Rng::seed_from_u64(3));
        let known = schedule.next_photos(14);
        let mut epochs = known.clone();
        for at in 0..14 {
            assert_eq!(schedule.next_photos(3.min(14 - at)), known[at..14.min(at + 3)]);
            assert_eq!(schedule.next_photo(), known[at]);
        }
        epochs.truncate(10);
        assert_ne!(epochs[..5], epochs[5..], "the control: each epoch has an order of its own");
        epochs.sort_unstable();
        assert_eq!(epochs, [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]);
    }
}
