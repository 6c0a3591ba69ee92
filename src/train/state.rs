//! Where a training stands in its schedule.

use std::sync::Arc;

use rand_chacha::ChaCha8Rng;

use crate::light::LightColour;
use crate::train::complexity::state::ComplexityState;
use crate::train::crop::CutOut;
use crate::train::exposure::Gain;

/// Where a training stands in its schedule; kept on the host whatever device trains.
#[derive(Debug, Clone, PartialEq)]
pub struct ScheduleState {
    /// Steps done.
    pub step: u32,
    /// Order in which this epoch visits the photographs.
    pub order: Vec<u32>,
    /// Position in `order`.
    pub cursor: u32,
    /// Source of every random choice.
    pub rng: ChaCha8Rng,
    /// Factor on all step sizes, lowered after a roll-back.
    pub rate_factor: f32,
    /// Seconds spent in steps.
    pub seconds: f64,
    /// What was decided about the model's size so far.
    pub complexity: ComplexityState,
    /// Colour of the light that materials started from, once they train.
    pub light_colour: Option<LightColour>,
    /// Gains that photographs were divided by, one list a time; empty where they are under one exposure.
    pub gains: Vec<Vec<Gain>>,
    /// Of each strong small light: the share by which sharp shadows explain the photographs better than soft ones.
    pub lights: Vec<f32>,
    /// What was cut out of photographs without masks, after the warm-up.
    pub cut: Option<Arc<CutOut>>,
}

impl ScheduleState {
    /// How often the photographs were changed.
    pub fn revision(&self) -> usize {
        self.gains.len() + usize::from(self.cut.is_some())
    }
}
