//! A training on the device.
//!
//! A step is two submissions: one that finds out how many tile instances the view has, and one with all the rest, which
//! ends with a read of sixteen sums. Between steps everything that is learned stays in device memory.

mod canvas;
mod photos;
mod size;
mod state;

use std::borrow::Cow;
use std::sync::Arc;

use crate::engine::channel::Channels;
use crate::engine::constants::EarlyStop;
use crate::engine::gpu::density;
use crate::engine::gpu::frame::{FrameBranches, FrameGradients, FramePass};
use crate::engine::gpu::gather::{LightProbes, gather, ungathered};
use crate::engine::gpu::light::{Constants, TrainingLight};
use crate::engine::gpu::objective::{LOSS_SLOTS, LossSlot, objective};
use crate::engine::gpu::probes;
use crate::engine::gpu::raster::{Differentiated, Raster};
use crate::engine::gpu::shading::Shading;
use crate::engine::gpu::training::canvas::Canvas;
use crate::engine::gpu::training::photos::PhotoCache;
use crate::engine::gpu::training::state::DeviceState;
use crate::engine::gpu::update::{STATUS_WORDS, StepInput, Sums, Updater, Upstream};
use crate::engine::gpu::{AttributeSource, Buffer, CameraUniform, Gpu, Recorder};
use crate::engine::{
    DensityPlan, DensitySignals, DeviceError, FieldUpdate, LightWeights, ProbeMeasurement, ProbeSettings,
    RasterCamera, Step, StepSums, TrainState, TrainingLimits, fibonacci_sphere, training,
};
use crate::light::EnvOperators;
use crate::scene::{IndirectForm, Model, VisibilityForm};

/// Slot of the sums that carries the status of the update: the last one, which no term has.
const STATUS_SLOT: usize = LOSS_SLOTS - 1;

/// A training on the device.
#[derive(Debug)]
pub struct Training {
    gpu: Gpu,
    /// Shape, options and card of the model; its parameters are those of the last load.
    shape: Model,
    state: DeviceState,
    /// The operators of the light.
    operators: Arc<EnvOperators>,
    /// With the operators of its light.
    snapshot: Option<(DeviceState, Arc<EnvOperators>)>,
    /// Degree of the measured visibility.
    order: usize,
    raster: Raster,
    light: TrainingLight,
    constants: Constants,
    updater: Updater,
    photos: PhotoCache,
    canvas: Option<Canvas>,
    losses: Buffer<f32>,
    /// Gradient of prototypes and raw environment.
    globals_gradient: Buffer<f32>,
    status: Buffer<u32>,
}

impl Training {
    /// Takes a training over and makes `state` its first snapshot.
    ///
    /// # Errors
    /// [`DeviceError::TooLarge`] or [`DeviceError::OutOfMemory`] when it does not fit.
    pub fn new(
        gpu: &Gpu,
        state: TrainState,
        operators: &Arc<EnvOperators>,
        limits: &TrainingLimits,
    ) -> Result<Self, DeviceError> {
        limits.check(gpu, &state.model.gaussians)?;
        let on_device = DeviceState::upload(gpu, &state)?;
        let mut training = Self {
            order: operators.order(),
            raster: Raster::new(gpu)?,
            light: TrainingLight::new(gpu, operators)?,
            constants: Constants::upload(gpu)?,
            updater: Updater::new(gpu)?,
            photos: PhotoCache::default(),
            canvas: None,
            losses: gpu.buffer("losses", LOSS_SLOTS)?,
            globals_gradient: gpu.buffer("gradient of what is shared", on_device.model.globals.len())?,
            status: gpu.buffer("status", STATUS_WORDS)?,
            gpu: gpu.clone(),
            shape: state.model,
            state: on_device,
            operators: operators.clone(),
            snapshot: None,
        };
        training.take_snapshot()?;
        Ok(training)
    }

    fn take_snapshot(&mut self) -> Result<(), DeviceError> {
        // The old copy goes first: three states at once may not fit.
        self.snapshot = None;
        self.snapshot = Some((self.state.copied(&self.gpu)?, self.operators.clone()));
        Ok(())
    }

    /// Takes other operators of the light and the lights that are theirs.
    fn change_operators(&mut self, operators: &Arc<EnvOperators>) -> Result<(), DeviceError> {
        self.light = TrainingLight::new(&self.gpu, operators)?;
        self.shape.lights = operators.split().clone();
        self.operators = operators.clone();
        Ok(())
    }

    /// What the frame of a step shows.
    fn pass(&self, step: &Step<'_>, channels: Channels) -> FramePass {
        let branches = match step.branches.is_physical() {
            false => FrameBranches::Radiance(step.background),
            true => FrameBranches::Both(Box::new(Shading {
                options: self.shape.shading,
                background: step.background,
                light: self.light.light.clone(),
                constants: self.constants.clone(),
            })),
        };
        FramePass { channels, blending: EarlyStop::WhenSaturated, branches }
    }

    /// Measures visibility, and gathers light over `bounces` rounds.
    fn measure_once(
        &mut self,
        how: &ProbeMeasurement<'_>,
        bounces: Option<usize>,
    ) -> Result<(), DeviceError> {
        let (gpu, model) = (&self.gpu, &self.state.model);
        let settings = ProbeSettings::of(&self.shape.shading);
        let directions = fibonacci_sphere(how.directions);
        let probes = probes::measure(gpu, &model.params, &model.layout, settings, &directions, self.order)?;
        let lights = &self.operators.split().lights;
        let lights = LightProbes::measure(gpu, &model.params, &model.layout, &self.shape.shading, lights)?;
        let mut recorder = gpu.record();
        if let Some(bounces) = bounces {
            let source = AttributeSource::new(model);
            self.state.measured.gathered.clear();
            for turn in how.turns {
                self.light.apply(&mut recorder, model, *turn, &LightWeights::default(), &self.losses);
                let gathered =
                    gather(&mut recorder, &probes, &source, &self.light.light, bounces, lights.as_ref())?;
                self.state.measured.gathered.push(gathered);
            }
        } else if lights.is_some() {
            self.state.measured.gathered = vec![ungathered(&mut recorder, model.len(), lights.as_ref())?];
        }
        let replaces = match how.field {
            FieldUpdate::Keep => false,
            FieldUpdate::Start => !self.state.measured.ever,
            FieldUpdate::Replace => true,
        };
        if replaces {
            probes.store(&mut recorder, &model.params, &model.layout)?;
        }
        recorder.submit()?;
        self.state.measured.labels = Some(probes.coefficients);
        self.state.measured.ever = true;
        Ok(())
    }
}

impl training::Training for Training {
    fn step(&mut self, step: &Step<'_>) -> Result<StepSums, DeviceError> {
        let gpu = self.gpu.clone();
        let photo = self.photos.upload(&gpu, step.photo_id, step.photo)?;
        let shading = &self.shape.shading;
        let camera = CameraUniform::new(&RasterCamera::new(&step.photo.camera, shading));
        let channels = step.branches.channels(&self.shape.gaussians, shading);
        let pass = self.pass(step, channels.blended);
        let canvas = Canvas::at(&mut self.canvas, &gpu, camera.pixels())?;
        let source = self.state.source(&self.light, step.photo.light);
        let projected = self.raster.prepare(&camera, &source)?;
        let mut recorder = gpu.record();
        recorder.clear(&self.losses);
        recorder.clear(&self.globals_gradient);
        recorder.clear(&self.status);
        let physical = step.branches.is_physical();
        if physical {
            let turn = step.photo.light.radians;
            self.light.apply(&mut recorder, &self.state.model, turn, &step.weights.light, &self.losses);
        }
        let frame = pass.forward(&mut recorder, projected)?;
        pass.images(&mut recorder, &frame, &canvas.images)?;
        canvas.terms(&mut recorder, step, channels.blended, &photo, &frame, &self.losses);
        let gradients = FrameGradients {
            by_images: &canvas.by_images,
            by_buffers: &canvas.by_buffers,
            by_tables: &self.light.tables_gradient,
            differentiated: channels.differentiated,
        };
        let frame = pass.backward(&mut recorder, frame, &gradients)?;
        let update = Update {
            shape: &self.shape,
            state: &self.state,
            light: &self.light,
            updater: &self.updater,
            losses: &self.losses,
            globals_gradient: &self.globals_gradient,
            status: &self.status,
        };
        update.record(&mut recorder, step, frame)?;
        // One read instead of two is one round trip less.
        recorder.copy(&self.status.cast(), 0, &self.losses, STATUS_SLOT, 1);
        recorder.submit()?;
        let sums = gpu.read(&self.losses, 0..LOSS_SLOTS)?;
        let poisoned = sums[STATUS_SLOT].to_bits() != 0;
        let loss = objective(&sums, &step.weights);
        let leading = if physical { LossSlot::PhysicalSquared } else { LossSlot::RadianceSquared };
        Ok(StepSums { loss, mse: sums[leading as usize], finite: loss.is_finite() && !poisoned })
    }

    fn measure(&mut self, how: &ProbeMeasurement<'_>) -> Result<(), DeviceError> {
        let gathers = how.bounces > 0 && self.shape.shading.indirect == IndirectForm::Gathered;
        if self.shape.shading.visibility == VisibilityForm::Off && !gathers {
            return Ok(());
        }
        for _ in 0..how.repeats {
            self.measure_once(how, gathers.then_some(how.bounces))?;
        }
        Ok(())
    }

    fn density_signals(&self) -> Result<DensitySignals, DeviceError> {
        density::read_signals(&self.gpu, &self.state.model, &self.state.density)
    }

    fn rebuild(&mut self, plan: &DensityPlan) -> Result<(), DeviceError> {
        let mut recorder = self.gpu.record();
        self.state.model = density::gather(&mut recorder, &self.state.model, plan)?;
        self.state.density = self.gpu.buffer("density statistics", plan.gaussians.len())?;
        recorder.clear(&self.state.density);
        recorder.submit()?;
        self.state.measured.forget_values();
        Ok(())
    }

    fn load(&mut self, state: TrainState) -> Result<(), DeviceError> {
        self.state = DeviceState::upload(&self.gpu, &state)?;
        self.shape = state.model;
        Ok(())
    }

    fn reshape(&mut self, state: TrainState, operators: &Arc<EnvOperators>) -> Result<(), DeviceError> {
        // The snapshot has the old shape.
        self.snapshot = None;
        self.load(state)?;
        self.order = operators.order();
        self.change_operators(operators)?;
        self.globals_gradient =
            self.gpu.buffer("gradient of what is shared", self.state.model.globals.len())?;
        self.take_snapshot()
    }

    fn light(&mut self, operators: &Arc<EnvOperators>) -> Result<(), DeviceError> {
        self.change_operators(operators)?;
        self.state.forget_arriving(&self.gpu)
    }

    fn snapshot(&mut self) -> Result<bool, DeviceError> {
        self.take_snapshot().map(|()| true)
    }

    fn roll_back(&mut self) -> Result<(), DeviceError> {
        let missing = || DeviceError::Misuse("there is no snapshot to return to".to_owned());
        let (state, operators) = self.snapshot.as_ref().ok_or_else(missing)?;
        let (state, operators) = (state.copied(&self.gpu)?, operators.clone());
        self.state = state;
        if Arc::ptr_eq(&operators, &self.operators) { Ok(()) } else { self.change_operators(&operators) }
    }

    fn gaussians(&self) -> usize {
        self.state.model.len()
    }

    fn state(&self) -> Result<Cow<'_, TrainState>, DeviceError> {
        self.state.download(&self.gpu, &self.shape).map(Cow::Owned)
    }

    fn engine(&self) -> &'static str {
        "gpu"
    }
}

/// What the parameter side of a step works on.
struct Update<'a> {
    shape: &'a Model,
    state: &'a DeviceState,
    light: &'a TrainingLight,
    updater: &'a Updater,
    losses: &'a Buffer<f32>,
    globals_gradient: &'a Buffer<f32>,
    status: &'a Buffer<u32>,
}

impl Update<'_> {
    /// From the splats' gradients to new parameters; to new prototypes and light where the physically based branch trains.
    fn record(
        &self,
        recorder: &mut Recorder<'_>,
        step: &Step<'_>,
        mut frame: Differentiated<'_>,
    ) -> Result<(), DeviceError> {
        let physical = step.branches.is_physical();
        let mut weights = step.weights.parameters;
        if self.shape.shading.visibility == VisibilityForm::Off {
            (weights.probe_labels, weights.view_labels) = (0.0, 0.0);
        }
        let view_labels = match weights.view_labels {
            0.0 => None,
            _ => Some(frame.backward_labels(recorder)?),
        };
        let indirect = if physical { self.shape.shading.indirect } else { IndirectForm::Off };
        let basis = (&self.light.light.indirect_basis, &self.light.basis_gradient);
        let sums = Sums {
            globals_gradient: self.globals_gradient,
            losses: self.losses,
            density: &self.state.density,
            status: self.status,
        };
        let upstream = Upstream {
            indirect_basis: (indirect == IndirectForm::Learned).then_some(basis),
            probe_labels: self.state.measured.labels.as_ref(),
            view_labels: view_labels.as_ref(),
            ..Upstream::new(&frame)
        };
        let model = &self.state.model;
        let input = StepInput { model, upstream, sums, weights };
        self.updater.step(recorder, &input, &step.sizes, step.counts);
        if physical {
            let (turn, weights) = (step.photo.light.radians, &step.weights.light);
            self.light.backward(recorder, model, turn, weights, indirect, self.globals_gradient);
            self.updater.step_globals(recorder, model, &sums, &step.sizes, step.counts);
        }
        Ok(())
    }
}
