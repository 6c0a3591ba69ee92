//! Training on the device.
//!
//! A step is one submission, which ends with a copy of its sums. The host waits for the sums of the previous step, so that the
//! device always has a step to execute. The training state stays in device memory between steps.

mod device_step;
mod image_buffers;
mod photos;
mod size;
mod state;
mod steps;
#[cfg(test)]
mod tests;

use std::borrow::Cow;
use std::sync::Arc;

use crate::gpu::gather::{LightProbes, add_sky_shadows, gather, ungathered};
use crate::gpu::light::{Constants, TrainingLight};
use crate::gpu::objective::LOSS_SLOTS;
use crate::gpu::raster::Raster;
use crate::gpu::training::device_step::SubmittedStep;
use crate::gpu::training::image_buffers::ImageBuffers;
use crate::gpu::training::photos::DevicePhotoCache;
use crate::gpu::training::state::DeviceState;
use crate::gpu::update::{STATUS_WORDS, Updater};
use crate::gpu::{AttributeSource, Buffer, Gpu, InFlightLimit, density, probes};
use crate::{
    DensityPlan, DensitySignals, DeviceError, FieldUpdate, LightWeights, PhotoId, ProbeMeasurement,
    ProbeSettings, Step, StepResult, TrainState, TrainingLimits, fibonacci_sphere, training,
};
use relume_scene::light::EnvOperators;
use relume_scene::{IndirectForm, Model, VisibilityForm};

/// Slot of the sums for the status of the update: the last slot, which no term uses.
const STATUS_SLOT: usize = LOSS_SLOTS - 1;

/// A training on the device.
#[derive(Debug)]
pub struct GpuTraining {
    gpu: Gpu,
    /// Shape, options and card of the model; its parameters are outdated (those of the last load).
    shape: Model,
    state: DeviceState,
    /// The operators of the light.
    operators: Arc<EnvOperators>,
    /// The snapshot, with the operators of its light.
    snapshot: Option<(DeviceState, Arc<EnvOperators>)>,
    /// Degree of the measured visibility.
    sh_degree: usize,
    raster: Raster,
    light: TrainingLight,
    constants: Constants,
    updater: Updater,
    photos: DevicePhotoCache,
    image_buffers: Option<ImageBuffers>,
    losses: Buffer<f32>,
    /// Gradient of prototypes and raw environment.
    globals_gradient: Buffer<f32>,
    status: Buffer<u32>,
    /// The last step, while its result is not known.
    pending: Option<SubmittedStep>,
}

impl GpuTraining {
    /// Starts a training from `state`, which is its first snapshot.
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
            sh_degree: operators.sh_degree(),
            raster: Raster::new(gpu)?,
            light: TrainingLight::new(gpu, operators)?,
            constants: Constants::upload(gpu)?,
            updater: Updater::new(gpu)?,
            photos: DevicePhotoCache::default(),
            image_buffers: None,
            losses: gpu.buffer("losses", LOSS_SLOTS)?,
            globals_gradient: gpu
                .buffer("gradient of the shared parameters", on_device.model.globals.len())?,
            status: gpu.buffer("status", STATUS_WORDS)?,
            gpu: gpu.clone(),
            shape: state.model,
            state: on_device,
            operators: operators.clone(),
            snapshot: None,
            pending: None,
        };
        training.take_snapshot()?;
        Ok(training)
    }

    fn take_snapshot(&mut self) -> Result<(), DeviceError> {
        // The old copy is freed first: three states at once may not fit.
        self.snapshot = None;
        self.snapshot = Some((self.state.copied(&self.gpu)?, self.operators.clone()));
        Ok(())
    }

    /// Sets other operators of the light, and their dominant lights.
    fn change_operators(&mut self, operators: &Arc<EnvOperators>) -> Result<(), DeviceError> {
        self.light = TrainingLight::new(&self.gpu, operators)?;
        self.shape.lights = operators.split().clone();
        self.operators = operators.clone();
        Ok(())
    }

    /// # Errors
    /// When a step is pending: the requested data could be that before or after it.
    fn check_finished(&self) -> Result<(), DeviceError> {
        match self.pending {
            Some(_) => Err(DeviceError::Misuse("a step of the training is not finished".to_owned())),
            None => Ok(()),
        }
    }

    /// Measures visibility and gathers light over `bounces` rounds.
    fn measure_once(
        &mut self,
        how: &ProbeMeasurement<'_>,
        bounces: Option<usize>,
    ) -> Result<(), DeviceError> {
        let (gpu, model) = (&self.gpu, &self.state.model);
        let settings = ProbeSettings::of(&self.shape.shading);
        let directions = fibonacci_sphere(how.directions);
        let probes = {
            let _span = tracing::debug_span!("probes").entered();
            probes::measure(gpu, &model.params, &model.layout, settings, &directions, self.sh_degree)?
        };
        let lights = &self.operators.split().lights;
        let lights = LightProbes::measure(gpu, &model.params, &model.layout, &self.shape.shading, lights)?;
        let _span = tracing::debug_span!("gather").entered();
        let mut pace = InFlightLimit::default();
        let replaces = match how.field {
            FieldUpdate::Keep => false,
            FieldUpdate::Start => !self.state.measured.ever,
            FieldUpdate::Replace => true,
        };
        if replaces {
            let mut recorder = gpu.record();
            probes.store(&mut recorder, &model.params, &model.layout)?;
            pace.follow(recorder.submit()?)?;
        }
        if let Some(bounces) = bounces {
            let source = AttributeSource::new(model);
            self.state.measured.gathered.clear();
            for light in how.lights {
                let mut recorder = gpu.record();
                self.light.apply(&mut recorder, model, *light, &LightWeights::default(), &self.losses);
                let gathered =
                    gather(&mut recorder, &probes, &source, &self.light.light, bounces, lights.as_ref())?;
                if self.shape.shading.has_sky_shadows() {
                    add_sky_shadows(&mut recorder, &probes, &source, &self.light.light, &gathered)?;
                }
                self.state.measured.gathered.push(gathered);
                pace.follow(recorder.submit()?)?;
            }
        } else if lights.is_some() {
            let mut recorder = gpu.record();
            self.state.measured.gathered = vec![ungathered(&mut recorder, model.len(), lights.as_ref())?];
            pace.follow(recorder.submit()?)?;
        }
        pace.finish()?;
        self.state.measured.labels = Some(probes.coefficients);
        self.state.measured.ever = true;
        Ok(())
    }
}

impl training::TrainingEngine for GpuTraining {
    fn step(&mut self, step: &Step<'_>) -> Result<Option<StepResult>, DeviceError> {
        let step = self.device_step(step)?;
        let submitted = self.submit(step)?;
        match self.pending.replace(submitted) {
            Some(earlier) => self.finish_step(earlier).map(Some),
            None => Ok(None),
        }
    }

    fn holds(&self, photo: PhotoId) -> bool {
        self.photos.holds(photo)
    }

    fn finish(&mut self) -> Result<Option<StepResult>, DeviceError> {
        self.pending.take().map(|pending| self.finish_step(pending)).transpose()
    }

    fn measure(&mut self, how: &ProbeMeasurement<'_>) -> Result<(), DeviceError> {
        self.check_finished()?;
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
        self.check_finished()?;
        density::read_signals(&self.gpu, &self.state.model, &self.state.density)
    }

    fn rebuild(&mut self, plan: &DensityPlan) -> Result<(), DeviceError> {
        self.check_finished()?;
        let mut recorder = self.gpu.record();
        let before = self.state.model.len();
        let plan = density::UploadedPlan::new(&self.gpu, plan, self.state.model.layout.n)?;
        self.state.model = density::gather(&mut recorder, &self.state.model, &plan)?;
        self.state.measured.inherit(&mut recorder, before, &plan)?;
        self.state.density = self.gpu.buffer("density statistics", self.state.model.len())?;
        recorder.clear(&self.state.density);
        recorder.submit()?;
        Ok(())
    }

    fn load(&mut self, state: TrainState) -> Result<(), DeviceError> {
        self.pending = None;
        self.state = DeviceState::upload(&self.gpu, &state)?;
        self.shape = state.model;
        Ok(())
    }

    fn reshape(&mut self, state: TrainState, operators: &Arc<EnvOperators>) -> Result<(), DeviceError> {
        // The snapshot has the old shape.
        self.snapshot = None;
        self.load(state)?;
        self.sh_degree = operators.sh_degree();
        self.change_operators(operators)?;
        self.globals_gradient =
            self.gpu.buffer("gradient of the shared parameters", self.state.model.globals.len())?;
        self.take_snapshot()
    }

    fn light(&mut self, operators: &Arc<EnvOperators>) -> Result<(), DeviceError> {
        self.check_finished()?;
        self.change_operators(operators)?;
        self.state.forget_arriving(&self.gpu)
    }

    fn snapshot(&mut self) -> Result<bool, DeviceError> {
        self.check_finished()?;
        self.take_snapshot().map(|()| true)
    }

    fn roll_back(&mut self) -> Result<(), DeviceError> {
        self.pending = None;
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
        self.check_finished()?;
        self.state.download(&self.gpu, &self.shape).map(Cow::Owned)
    }

    fn engine(&self) -> &'static str {
        "gpu"
    }
}
