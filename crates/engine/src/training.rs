//! Interface between the schedule of a training and the engine that computes it.
//!
//! A call computes a whole step. Between steps a device keeps the training state in its own memory. The host reads the state
//! only for a checkpoint, a model or a decision.

use std::borrow::Cow;
use std::sync::Arc;

use crate::density::{DensityPlan, DensitySignals};
use crate::step::{PhotoId, ProbeMeasurement, Step, StepResult};
use crate::{DeviceError, TrainState};
use relume_scene::light::EnvOperators;

/// A training on one device.
///
/// A device may compute a step while the host prepares the next one, so results arrive one call later. Call every method
/// except [`TrainingEngine::step`], [`TrainingEngine::load`], [`TrainingEngine::reshape`] and [`TrainingEngine::roll_back`] only after
/// [`TrainingEngine::finish`].
pub trait TrainingEngine: Send {
    /// Objective, gradients, density statistics and parameter update for one photograph. After a step that is not finite,
    /// training must not continue from the state. Returns each step's result once and in order: the result of this step or,
    /// if there is one, of the previous step.
    ///
    /// # Errors
    /// Errors of the device; as for every method here.
    fn step(&mut self, step: &Step<'_>) -> Result<Option<StepResult>, DeviceError>;

    /// True when the device has the pixels of a photograph, so that a step needs none ([`Photo`](crate::Photo)).
    fn holds(&self, photo: PhotoId) -> bool;

    /// Waits until every step is done; returns the result of the last step, if no call has returned it yet.
    fn finish(&mut self) -> Result<Option<StepResult>, DeviceError>;

    /// Measures visibility and gathered light again.
    fn measure(&mut self, how: &ProbeMeasurement<'_>) -> Result<(), DeviceError>;

    /// The signals from which density control plans a round.
    fn density_signals(&self) -> Result<DensitySignals, DeviceError>;

    /// Rebuilds the model by `plan` and clears the statistics. New Gaussians have the measurements of their sources.
    fn rebuild(&mut self, plan: &DensityPlan) -> Result<(), DeviceError>;

    /// Continues from another state of the same shape. This method and the next one discard unfinished steps.
    fn load(&mut self, state: TrainState) -> Result<(), DeviceError>;

    /// Continues from a state of another shape (SH degrees, prototypes, forward model, number of Gaussians) with its operators,
    /// and makes it the snapshot. The state must be finite.
    fn reshape(&mut self, state: TrainState, operators: &Arc<EnvOperators>) -> Result<(), DeviceError>;

    /// Continues with `operators` that split other dominant lights off; environment size, visibility degree and resolution are
    /// the same. The model gets the lights of the operators. The next measurement finds their shadows; until then they
    /// arrive unshadowed.
    fn light(&mut self, operators: &Arc<EnvOperators>) -> Result<(), DeviceError>;

    /// Makes the current state the target of [`TrainingEngine::roll_back`], unless it is known not to be finite. Returns
    /// whether the snapshot was taken.
    fn snapshot(&mut self) -> Result<bool, DeviceError>;

    /// Returns to the last snapshot and discards unfinished steps.
    fn roll_back(&mut self) -> Result<(), DeviceError>;

    /// Current number of Gaussians.
    fn gaussians(&self) -> usize;

    /// The training state on the host: borrowed from the CPU engine, copied from any other device.
    fn state(&self) -> Result<Cow<'_, TrainState>, DeviceError>;

    /// Name of the engine, for the model card.
    fn engine(&self) -> &'static str;
}

/// Largest size of a training, so that a device can refuse it before the first step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TrainingLimits {
    /// Requested longest side, pixels; for error messages.
    pub resolution: u32,
    /// Pixels of the largest photograph.
    pub pixels: usize,
    /// Maximum number of Gaussians.
    pub max_gaussians: u32,
    /// Probe directions.
    pub probe_directions: u32,
}
