//! What a trainer asks of an engine, and what it gets back: plain data.

use crate::engine::RasterCamera;
use crate::engine::channel::Channels;
use crate::engine::density::DensityStats;
use crate::engine::objective::StepWeights;
use crate::scene::{Field, Gaussians, Model};

/// Names a photograph at one of its resolutions, so that a device can keep it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct PhotoKey {
    /// Index of the photograph.
    pub index: usize,
    /// Times its resolution was halved.
    pub halvings: u32,
}

/// A photograph as a step compares with it.
#[derive(Debug, Clone, Copy)]
pub struct Photograph<'a> {
    /// Its name.
    pub key: PhotoKey,
    /// Display-referred rgb over the step's background, row-major.
    pub pixels: &'a [[f32; 3]],
    /// Mask by pixel, 0 to 1; where it ends, 1.
    pub alpha: &'a [f32],
}

/// Adam's step sizes; zero leaves a field and its moments alone.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StepSizes {
    /// Per field, by discriminant.
    pub fields: [f32; Field::COUNT],
    /// Albedo prototypes.
    pub prototypes: f32,
    /// Raw environment.
    pub environment: f32,
}

/// How many steps geometry with radiance, and material with light, have trained, this one included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StepCounts {
    /// Geometry and radiance.
    pub geometry: u32,
    /// Material, visibility and light.
    pub material: u32,
}

/// One optimisation step.
#[derive(Debug, Clone, Copy)]
pub struct Step<'a> {
    /// The camera.
    pub camera: RasterCamera,
    /// The photograph.
    pub photo: Photograph<'a>,
    /// What the photograph was composited over, display-referred.
    pub background: [f32; 3],
    /// Channels of the pass: `Material` or `Full` for the physically based branch, fewer for the radiance branch alone.
    pub channels: Channels,
    /// Channels whose gradient is carried back.
    pub differentiated: Channels,
    /// The objective.
    pub weights: StepWeights,
    /// Adam's step sizes.
    pub sizes: StepSizes,
    /// Adam's step counts.
    pub counts: StepCounts,
}

/// Values of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepSums {
    /// The objective before the step.
    pub loss: f32,
    /// Mean squared error of the leading branch.
    pub mse: f32,
    /// False when a gradient or the objective was not finite: the state must not be built on.
    pub finite: bool,
}

/// What a measurement does to the visibility field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldUpdate {
    /// Nothing: it gives labels only.
    Keep,
    /// It becomes the field if nothing was measured before.
    Start,
    /// It becomes the field.
    Replace,
}

/// How visibility and bounced light are measured (docs/MODEL.md section 6).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Measurement {
    /// Probe directions.
    pub directions: usize,
    /// Rounds of gathered light, or `None` to gather nothing.
    pub bounces: Option<usize>,
    /// What becomes of the visibility field.
    pub field: FieldUpdate,
}

/// All that a training has learned and measured.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingState {
    /// The model.
    pub model: Model,
    /// First and second moments of the Gaussians.
    pub moments: [Gaussians; 2],
    /// First and second moments of prototypes, then environment.
    pub globals: [Vec<[f32; 3]>; 2],
    /// Density statistics since the last round.
    pub density: DensityStats,
    /// Probe labels, `[Gaussian][coefficient]`; empty if nothing was measured.
    pub labels: Vec<f32>,
    /// Gathered light per Gaussian; empty if nothing was gathered.
    pub gathered: Vec<[f32; 6]>,
}
