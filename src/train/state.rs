//! Everything that changes while a training runs; saving it saves the training.

use rand_chacha::ChaCha8Rng;

use crate::engine::density::DensityStats;
use crate::scene::Model;
use crate::train::complexity::state::ComplexityState;
use crate::train::optimiser::Moments;

/// Where a training stands in its schedule; kept on the host whatever device trains.
#[derive(Debug, Clone, PartialEq)]
pub struct Course {
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
}

/// What has been learned and measured so far; lives where the training runs.
#[derive(Debug, Clone, PartialEq)]
pub struct Learned {
    /// The model.
    pub model: Model,
    /// Optimiser moments.
    pub moments: Moments,
    /// Density statistics since the last round.
    pub density: DensityStats,
    /// Probe labels, `[Gaussian][coefficient]`; empty before the first refresh.
    pub labels: Vec<f32>,
    /// Gathered light per Gaussian; empty before the first refresh.
    pub gathered: Vec<[f32; 6]>,
}

impl Learned {
    /// The start from an initial model.
    pub fn new(model: Model) -> Self {
        Self {
            moments: Moments::zeroed(&model),
            density: DensityStats::zeroed(model.gaussians.len()),
            labels: Vec::new(),
            gathered: Vec::new(),
            model,
        }
    }
}
