//! Everything a training keeps on the device, and one optimisation step in terms of the kernels' hosts.
//!
//! A step is two submissions: one that finds out how many tile instances the view has, and one with all the rest, which
//! ends with a read of sixteen sums. Nothing else crosses the bus.

use crate::engine::channel::Channels;
use crate::engine::cpu::{ProbeSettings, View, fibonacci_sphere};
use crate::engine::gpu::gather::{GatherSource, gather};
use crate::engine::gpu::light::{Constants, LightWeights, TrainingLight};
use crate::engine::gpu::losses::{ImageWeights, Losses, SurfaceWeights};
use crate::engine::gpu::model::ModelBuffers;
use crate::engine::gpu::probes::Probes;
use crate::engine::gpu::raster::groups;
use crate::engine::gpu::shading::{
    Images, ShadeGradients, ShadeJob, ShadingUniform, radiance_image, radiance_image_backward, shade, shade_backward,
};
use crate::engine::gpu::update::{Ages, ParameterTerms, Rates, STATUS_WORDS, Sums, Updater, Upstream};
use crate::engine::gpu::{AttributeBuffers, Buffer, Gpu, GpuError, Raster, Recorder, ViewUniform};
use crate::light::EnvOperators;
use crate::scene::{IndirectForm, ShadingOptions};

/// Weights of all terms of the objective (docs/MODEL.md section 5); 0 is off.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StepWeights {
    /// Image term of the physically based branch.
    pub physical: ImageWeights,
    /// Image term of the radiance branch.
    pub radiance: ImageWeights,
    /// Terms on the G-buffer.
    pub surface: SurfaceWeights,
    /// Terms on the light.
    pub light: LightWeights,
    /// Terms on the parameters.
    pub parameters: ParameterTerms,
}

/// One optimisation step.
#[derive(Debug, Clone, Copy)]
pub struct Step<'a> {
    /// The camera.
    pub view: View,
    /// The photograph, row-major: rgb over the background, mask.
    pub photo: &'a Buffer<[f32; 4]>,
    /// What the photograph was composited over, display-referred.
    pub background: [f32; 3],
    /// Channels of the pass: `Full` for the physically based branch, fewer for the radiance branch alone.
    pub channels: Channels,
    /// Channels the way back carries.
    pub differentiated: Channels,
    /// The objective.
    pub weights: StepWeights,
    /// Adam's step sizes.
    pub rates: Rates,
    /// Adam's ages.
    pub ages: Ages,
}

/// What a step came to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepSums {
    /// The objective.
    pub loss: f32,
    /// Mean squared error of the leading branch.
    pub mse: f32,
    /// False when a gradient or the objective was not finite: the state must not be built on.
    pub finite: bool,
}

/// What is measured, not learned.
#[derive(Debug, Clone, Default)]
pub struct Measured {
    /// Probe labels, `[Gaussian][coefficient]`.
    pub labels: Option<Buffer<f32>>,
    /// Gathered light, 6 floats a Gaussian.
    pub gathered: Option<Buffer<f32>>,
}

/// The state a training can return to.
#[derive(Debug)]
struct Kept {
    model: ModelBuffers,
    density: Buffer<[f32; 2]>,
    measured: Measured,
}

/// A training on the device.
#[derive(Debug)]
pub struct Training {
    gpu: Gpu,
    /// Parameters and moments.
    pub model: ModelBuffers,
    /// Sum of screen gradients and steps on screen, by Gaussian.
    pub density: Buffer<[f32; 2]>,
    /// What is measured, not learned.
    pub measured: Measured,
    options: ShadingOptions,
    order: usize,
    raster: Raster,
    light: TrainingLight,
    constants: Constants,
    losses: Losses,
    updater: Updater,
    images: Option<Images>,
    by_gbuffer: Option<Buffer<[f32; 4]>>,
    globals_gradient: Buffer<f32>,
    status: Buffer<u32>,
    kept: Option<Kept>,
}
