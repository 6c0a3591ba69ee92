//! A training on the GPU engine: from the configuration to the weights of a step.

use std::borrow::Cow;

use crate::engine::channel::Channels;
use crate::engine::gpu::Gpu;
use crate::engine::gpu::training::{Training, TrainingSize};
use crate::engine::{
    FieldUpdate, ImageWeights, LightWeights, Measurement, ParameterWeights, PhotoKey, Photograph,
    RasterCamera, Step, StepCounts, StepSizes, StepWeights, SurfaceWeights, TrainingState,
};
use crate::light::EnvOperators;
use crate::scene::{IndirectForm, VisibilityForm};
use crate::train::backend::{Backend, StepTask, StepValue};
use crate::train::density;
use crate::train::optimiser::Moments;
use crate::train::state::Learned;
use crate::train::step::{self, StepContext};
use crate::train::{LabelSource, TrainConfig, TrainError};

/// The training on the device.
pub(super) struct OnGpu {
    training: Training,
}

impl From<Learned> for TrainingState {
    fn from(learned: Learned) -> Self {
        let Learned { model, moments: Moments { first, second, globals }, density, labels, gathered } =
            learned;
        Self { model, moments: [first, second], globals, density, labels, gathered }
    }
}

impl From<TrainingState> for Learned {
    fn from(state: TrainingState) -> Self {
        let TrainingState { model, moments: [first, second], globals, density, labels, gathered } = state;
        Self { model, moments: Moments { first, second, globals }, density, labels, gathered }
    }
}

impl OnGpu {
    /// `pixels`: those of the largest photograph.
    pub(super) fn new(
        gpu: &Gpu,
        config: &TrainConfig,
        operators: &EnvOperators,
        learned: Learned,
        pixels: usize,
    ) -> Result<Self, TrainError> {
        let size = TrainingSize {
            resolution: config.resolution,
            pixels,
            initial_gaussians: config.initial_gaussians,
            max_gaussians: config.max_gaussians,
            probe_directions: config.probe_directions,
        };
        size.check(gpu, &learned.model.gaussians)?;
        Ok(Self { training: Training::new(gpu, operators, learned.into())? })
    }

    /// Channels of a step's pass, and those its way back carries.
    fn channels(&self, task: &StepTask<'_>) -> (Channels, Channels) {
        let (config, progress) = (task.context.config, task.context.progress);
        if task.material {
            return step::channels(config, self.training.shape());
        }
        let shaped = step::is_shaped(config, progress);
        let channels = if shaped { Channels::Geometry } else { Channels::Colour };
        (channels, channels)
    }

    fn weights(&self, task: &StepTask<'_>, channels: Channels) -> StepWeights {
        let (config, w) = (task.context.config, &task.context.config.weights);
        let if_material = |weight: f32| if task.material { weight } else { 0.0 };
        let share = if task.material { config.radiance_weight(task.context.has_alpha) } else { 1.0 };
        let visible = task.material && self.training.shape().shading.visibility != VisibilityForm::Off;
        let labels = |sources: &[LabelSource]| {
            if visible && sources.contains(&config.labels) { w.visibility } else { 0.0 }
        };
        StepWeights {
            physical: ImageWeights { l1: if_material(w.l1), ssim: if_material(w.ssim) },
            radiance: ImageWeights { l1: w.l1 * share, ssim: w.ssim * share },
            surface: SurfaceWeights {
                coverage: if task.context.has_alpha { w.coverage } else { 0.0 },
                depth_normal: if channels == Channels::Colour { 0.0 } else { w.depth_normal },
                smoothness: w.smooth().map(if_material),
            },
            light: LightWeights {
                neutrality: if_material(w.light),
                exposure: if_material(w.exposure),
                daylight: if_material(config.daylight_weight(task.context.progress)),
            },
            parameters: ParameterWeights {
                aggregation: if_material(w.aggregation),
                residual: if_material(w.residual),
                flatness: w.flatness,
                probe_labels: labels(&[LabelSource::Both]),
                view_labels: labels(&[LabelSource::Backward, LabelSource::Both]),
            },
        }
    }
}

impl Backend for OnGpu {
    fn step(&mut self, task: &StepTask<'_>) -> Result<StepValue, TrainError> {
        let (channels, differentiated) = self.channels(task);
        let (index, is_half) = task.photo_key;
        let (photo, sizes) = (task.photo, &task.sizes);
        let sums = self.training.step(&Step {
            camera: RasterCamera::new(&photo.camera, &self.training.shape().shading),
            photo: Photograph {
                key: PhotoKey { index, halvings: u32::from(is_half) },
                pixels: &photo.pixels,
                alpha: &photo.alpha,
            },
            background: task.context.background,
            channels,
            differentiated,
            weights: self.weights(task, channels),
            sizes: StepSizes {
                fields: sizes.fields,
                prototypes: sizes.prototypes,
                environment: sizes.environment,
            },
            counts: StepCounts { geometry: task.ages[0], material: task.ages[1] },
        })?;
        Ok(StepValue { loss: sums.loss, mse: sums.mse, finite: sums.finite })
    }

    fn refresh_probes(&mut self, context: &StepContext<'_>, twice: bool) -> Result<(), TrainError> {
        let (config, shading) = (context.config, &self.training.shape().shading);
        let gathers = config.bounces > 0 && shading.indirect == IndirectForm::Gathered;
        if shading.visibility == VisibilityForm::Off && !gathers {
            return Ok(());
        }
        let measurement = Measurement {
            directions: config.probe_directions as usize,
            bounces: gathers.then_some(config.bounces as usize),
            field: match config.labels {
                LabelSource::Probes => FieldUpdate::Replace,
                LabelSource::Both => FieldUpdate::Start,
                LabelSource::None | LabelSource::Backward => FieldUpdate::Keep,
            },
        };
        for _ in 0..if twice { 2 } else { 1 } {
            self.training.measure(&measurement)?;
        }
        Ok(())
    }

    fn refine(&mut self, budget: usize, eyes: Option<&[[f32; 3]]>) -> Result<(), TrainError> {
        let plan = density::plan(&self.training.density_signals()?, budget, eyes);
        Ok(self.training.rebuild(&plan)?)
    }

    fn load(&mut self, learned: Learned) -> Result<(), TrainError> {
        Ok(self.training.load(learned.into())?)
    }

    fn reshape(&mut self, learned: Learned, operators: &EnvOperators) -> Result<(), TrainError> {
        Ok(self.training.reshape(operators, learned.into())?)
    }

    fn keep(&mut self) -> Result<bool, TrainError> {
        self.training.snapshot()?;
        Ok(true)
    }

    fn restore(&mut self) -> Result<(), TrainError> {
        Ok(self.training.restore()?)
    }

    fn gaussians(&self) -> usize {
        self.training.gaussians()
    }

    fn learned(&self) -> Result<Cow<'_, Learned>, TrainError> {
        Ok(Cow::Owned(self.training.state()?.into()))
    }

    fn engine(&self) -> &'static str {
        "gpu"
    }
}
