//! The seam between the schedule of a training and the device that does its arithmetic.
//!
//! It is as wide as a whole step: between two steps a GPU keeps everything it has learned in its own memory, and the
//! host asks for it only when a checkpoint or a model is wanted.

use std::borrow::Cow;

use crate::light::EnvOperators;
use crate::train::TrainError;
use crate::train::dataset::Photo;
use crate::train::optimiser::StepSizes;
use crate::train::state::Learned;
use crate::train::step::StepContext;

/// One optimisation step, as the schedule wants it.
pub(super) struct StepTask<'a> {
    /// What is the same for all steps, and how far the training is.
    pub context: StepContext<'a>,
    /// The photograph.
    pub photo: &'a Photo,
    /// Names the photograph and its resolution, so that a device can keep it.
    pub photo_key: (usize, bool),
    /// Whether the physically based branch trains, or radiance and geometry alone.
    pub material: bool,
    /// Adam's step sizes.
    pub sizes: StepSizes,
    /// Steps that geometry with radiance, and material with light, have trained, this one included.
    pub ages: [u32; 2],
}

/// What a step came to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StepValue {
    /// The objective before the step.
    pub loss: f32,
    /// Mean squared error of the leading branch.
    pub mse: f32,
    /// Loss and gradients were finite; otherwise nothing may be built on the state.
    pub finite: bool,
}

/// The arithmetic of a training on one device.
pub(super) trait Backend: Send {
    /// Objective, gradients, density statistics and parameter update for one photograph.
    fn step(&mut self, task: &StepTask<'_>) -> Result<StepValue, TrainError>;

    /// Measures visibility and gathers bounced light anew (docs/MODEL.md section 6).
    fn refresh_probes(&mut self, context: &StepContext<'_>, twice: bool) -> Result<(), TrainError>;

    /// One round of density control up to `budget` Gaussians; `eyes` as in `density::plan`.
    fn refine(&mut self, budget: usize, eyes: Option<&[[f32; 3]]>) -> Result<(), TrainError>;

    /// Goes on from another state.
    fn load(&mut self, learned: Learned) -> Result<(), TrainError>;

    /// Goes on from a state of another shape (orders, prototypes, forward model, number of Gaussians), with the operators
    /// that belong to it, and makes it the one that [`Backend::restore`] returns to. The state must be finite.
    fn reshape(&mut self, learned: Learned, operators: &EnvOperators) -> Result<(), TrainError>;

    /// Makes this the state that [`Backend::restore`] returns to, unless it is not finite; says whether it is.
    fn keep(&mut self) -> Result<bool, TrainError>;

    /// Returns to the state kept last.
    fn restore(&mut self) -> Result<(), TrainError>;

    /// Gaussians now.
    fn gaussians(&self) -> usize;

    /// All that has been learned, on the host.
    fn learned(&self) -> Result<Cow<'_, Learned>, TrainError>;

    /// Name of the engine, for the model card.
    fn engine(&self) -> &'static str;
}
