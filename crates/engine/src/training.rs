//! The seam between the schedule of a training and the engine that does its arithmetic.
//!
//! It is as wide as a whole step: between two steps a device keeps everything learned in its own memory, and the host
//! asks for it only when a checkpoint, a model or a decision needs it.

use std::borrow::Cow;
use std::sync::Arc;

use crate::density::{DensityPlan, DensitySignals};
use crate::step::{PhotoId, ProbeMeasurement, Step, StepResult};
use crate::{DeviceError, TrainState};
use relume_scene::light::EnvOperators;

/// The arithmetic of a training on one device.
///
/// A device may work on a step while the host prepares the next one, so that what a step came to is known later. Everything
/// but [`TrainingEngine::step`], [`TrainingEngine::load`], [`TrainingEngine::reshape`] and [`TrainingEngine::roll_back`] wants to be asked after
/// [`TrainingEngine::finish`].
pub trait TrainingEngine: Send {
    /// Objective, gradients, density statistics and parameter update for one photograph. A step that is not finite leaves
    /// a state that must not be built on. Gives what a step came to, each step's once and in their order: this one's, or that
    /// of the step before, if there is one.
    ///
    /// # Errors
    /// What went wrong on the device; as for every method here.
    fn step(&mut self, step: &Step<'_>) -> Result<Option<StepResult>, DeviceError>;

    /// Whether the device has the pixels of a photograph, so that a step needs none of them ([`Photo`](crate::Photo)).
    fn holds(&self, photo: PhotoId) -> bool;

    /// Waits until every step is done; gives what the last one came to, where that was not given yet.
    fn finish(&mut self) -> Result<Option<StepResult>, DeviceError>;

    /// Measures visibility and gathered light anew.
    fn measure(&mut self, how: &ProbeMeasurement<'_>) -> Result<(), DeviceError>;

    /// What density control plans from.
    fn density_signals(&self) -> Result<DensitySignals, DeviceError>;

    /// Rebuilds the model as `plan` says and clears the statistics.
    fn rebuild(&mut self, plan: &DensityPlan) -> Result<(), DeviceError>;

    /// Goes on from another state of the same shape; steps that are not done are forgotten, here and in the next method.
    fn load(&mut self, state: TrainState) -> Result<(), DeviceError>;

    /// Goes on from a state of another shape (orders, prototypes, forward model, number of Gaussians) with the operators
    /// that belong to it, and makes it the snapshot. The state must be finite.
    fn reshape(&mut self, state: TrainState, operators: &Arc<EnvOperators>) -> Result<(), DeviceError>;

    /// Goes on under `operators` of the same environment, visibility and resolution that take other lights out of it. The
    /// model's lights become theirs; the next measurement finds their shadows, until then all of them arrives.
    fn light(&mut self, operators: &Arc<EnvOperators>) -> Result<(), DeviceError>;

    /// Makes this the state that [`TrainingEngine::roll_back`] returns to, unless it is known not to be finite; says whether it
    /// was taken.
    fn snapshot(&mut self) -> Result<bool, DeviceError>;

    /// Returns to the last snapshot; steps that are not done are forgotten.
    fn roll_back(&mut self) -> Result<(), DeviceError>;

    /// Gaussians now.
    fn gaussians(&self) -> usize;

    /// All that has been learned, on the host.
    fn state(&self) -> Result<Cow<'_, TrainState>, DeviceError>;

    /// Name of the engine, for the model card.
    fn engine(&self) -> &'static str;
}

/// How large a training may become, so that a device can refuse it before the first step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TrainingLimits {
    /// Longest side asked for, pixels; for the message.
    pub resolution: u32,
    /// Pixels of the largest photograph.
    pub pixels: usize,
    /// Most Gaussians.
    pub max_gaussians: u32,
    /// Probe directions.
    pub probe_directions: u32,
}
