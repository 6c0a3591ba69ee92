//! A training on the device.
//!
//! A step is two submissions: one that finds out how many tile instances the view has, and one with all the rest, which
//! ends with a read of sixteen sums. Between steps everything that is learned stays in device memory.

mod canvas;
mod photos;
mod size;
mod state;

pub use size::TrainingSize;

use crate::engine::channel::Channels;
use crate::engine::density::{DensityPlan, DensitySignals};
use crate::engine::gpu::density;
use crate::engine::gpu::frame::{Branches, FrameGradients, FramePass};
use crate::engine::gpu::gather::gather;
use crate::engine::gpu::light::{Constants, TrainingLight};
use crate::engine::gpu::objective::{LOSS_SLOTS, LossSlot, objective};
use crate::engine::gpu::probes;
use crate::engine::gpu::raster::{Differentiated, Raster};
use crate::engine::gpu::shading::Shading;
use crate::engine::gpu::training::canvas::Canvas;
use crate::engine::gpu::training::photos::PhotoCache;
use crate::engine::gpu::training::state::DeviceState;
use crate::engine::gpu::update::{STATUS_LEN, StepInput, Sums, Updater, Upstream};
use crate::engine::gpu::{AttributeSource, Buffer, CameraUniform, Gpu, GpuError, Recorder};
use crate::engine::{
    Blending, FieldUpdate, LightWeights, Measurement, ProbeSettings, Step, StepSums, TrainingState,
    fibonacci_sphere,
};
use crate::light::EnvOperators;
use crate::scene::{IndirectForm, Model};

/// Slot of the sums that carries the status of the update: the last one, which no term has.
const STATUS_SLOT: usize = LOSS_SLOTS - 1;

/// A training on the device.
#[derive(Debug)]
pub struct Training {
    gpu: Gpu,
    /// Shape, options and card of the model; its parameters are those of the last load.
    shape: Model,
    state: DeviceState,
    snapshot: Option<DeviceState>,
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
    /// [`GpuError::TooLarge`] or [`GpuError::OutOfMemory`] when it does not fit.
    pub fn new(gpu: &Gpu, operators: &EnvOperators, state: TrainingState) -> Result<Self, GpuError> {
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
            status: gpu.buffer("status", STATUS_LEN)?,
            gpu: gpu.clone(),
            shape: state.model,
            state: on_device,
            snapshot: None,
        };
        training.snapshot()?;
        Ok(training)
    }

    /// Continues from another state of the same shape but for the number of Gaussians; the snapshot stays.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn load(&mut self, state: TrainingState) -> Result<(), GpuError> {
        self.state = DeviceState::upload(&self.gpu, &state)?;
        self.shape = state.model;
        Ok(())
    }

    /// Continues from a state of another shape (orders, prototypes, forward model), with its operators, and makes it the
    /// snapshot.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn reshape(&mut self, operators: &EnvOperators, state: TrainingState) -> Result<(), GpuError> {
        // The snapshot has the old shape.
        self.snapshot = None;
        self.load(state)?;
        self.order = operators.order();
        self.light = TrainingLight::new(&self.gpu, operators)?;
        self.globals_gradient =
            self.gpu.buffer("gradient of what is shared", self.state.model.globals.len())?;
        self.snapshot()
    }

    /// Makes this the state that [`Self::restore`] returns to.
    ///
    /// # Errors
    /// When the device has no memory left for a copy.
    pub fn snapshot(&mut self) -> Result<(), GpuError> {
        // The old copy goes first: three states at once may not fit.
        self.snapshot = None;
        self.snapshot = Some(self.state.copied(&self.gpu)?);
        Ok(())
    }

    /// Returns to the last snapshot.
    ///
    /// # Errors
    /// [`GpuError::Misuse`] when the last snapshot failed, or when the device has no memory left for a copy.
    pub fn restore(&mut self) -> Result<(), GpuError> {
        let missing = || GpuError::Misuse("there is no snapshot to return to".to_owned());
        self.state = self.snapshot.as_ref().ok_or_else(missing)?.copied(&self.gpu)?;
        Ok(())
    }

    /// All that has been learned, read back to the host.
    ///
    /// # Errors
    /// What went wrong on the device.
    pub fn state(&self) -> Result<TrainingState, GpuError> {
        self.state.download(&self.gpu, &self.shape)
    }

    /// Gaussians now.
    pub fn gaussians(&self) -> usize {
        self.state.model.len()
    }

    /// The model as it was last loaded: its shape, options and card are those of the training.
    pub fn shape(&self) -> &Model {
        &self.shape
    }

    /// One optimisation step; waits for its sums.
    ///
    /// # Errors
    /// What went wrong on the device.
    pub fn step(&mut self, step: &Step<'_>) -> Result<StepSums, GpuError> {
        let gpu = self.gpu.clone();
        let photo = self.photos.upload(&gpu, &step.photo)?;
        let camera = CameraUniform::new(&step.camera);
        let pass = self.pass(step);
        let canvas = Canvas::at(&mut self.canvas, &gpu, camera.pixels())?;
        let source = self.state.source(&self.light);
        let projected = self.raster.prepare(&camera, &source)?;
        let mut recorder = gpu.record();
        recorder.clear(&self.losses);
        recorder.clear(&self.globals_gradient);
        recorder.clear(&self.status);
        let physical = matches!(pass.branches, Branches::Both(_));
        if physical {
            self.light.apply(&mut recorder, &self.state.model, &step.weights.light, &self.losses);
        }
        let frame = pass.forward(&mut recorder, projected)?;
        pass.images(&mut recorder, &frame, &canvas.images)?;
        canvas.terms(&mut recorder, step, &photo, &frame, &self.losses);
        let gradients = FrameGradients {
            by_images: &canvas.by_images,
            by_buffers: &canvas.by_buffers,
            by_tables: &self.light.tables_gradient,
            differentiated: step.differentiated,
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
        update.record(&mut recorder, step, frame, physical)?;
        // One read instead of two is one round trip less.
        recorder.copy(&self.status.cast(), 0, &self.losses, STATUS_SLOT, 1);
        recorder.submit()?;
        let sums = gpu.read(&self.losses, 0..LOSS_SLOTS)?;
        let poisoned = sums[STATUS_SLOT].to_bits() != 0;
        let loss = objective(&sums, &step.weights);
        let leading = if physical { LossSlot::PhysicalSquared } else { LossSlot::RadianceSquared };
        Ok(StepSums { loss, mse: sums[leading as usize], finite: loss.is_finite() && !poisoned })
    }

    /// What the frame of a step shows.
    fn pass(&self, step: &Step<'_>) -> FramePass {
        let branches = match step.channels {
            Channels::Colour | Channels::Geometry => Branches::Radiance(step.background),
            Channels::Material | Channels::Full(_) => Branches::Both(Shading {
                options: self.shape.shading,
                background: step.background,
                light: self.light.light.clone(),
                constants: self.constants.clone(),
            }),
        };
        FramePass { channels: step.channels, blending: Blending::EarlyStop, branches }
    }

    /// Measures visibility and gathers bounced light anew (docs/MODEL.md section 6).
    ///
    /// # Errors
    /// What went wrong on the device.
    pub fn measure(&mut self, measurement: &Measurement) -> Result<(), GpuError> {
        let (gpu, model) = (&self.gpu, &self.state.model);
        let settings = ProbeSettings::of(&self.shape.shading);
        let directions = fibonacci_sphere(measurement.directions);
        let probes = probes::measure(gpu, &model.params, &model.layout, settings, &directions, self.order)?;
        let mut recorder = gpu.record();
        if let Some(bounces) = measurement.bounces {
            self.light.apply(&mut recorder, model, &LightWeights::default(), &self.losses);
            let source = AttributeSource::new(model);
            let gathered = gather(&mut recorder, &probes, &source, &self.light.light, bounces)?;
            self.state.measured.gathered = Some(gathered);
        }
        let replaces = match measurement.field {
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

    /// What density control chooses from.
    ///
    /// # Errors
    /// What went wrong on the device.
    pub fn density_signals(&self) -> Result<DensitySignals, GpuError> {
        density::read_signals(&self.gpu, &self.state.model, &self.state.density)
    }

    /// Rebuilds the model as `plan` says, and clears the statistics. Labels and gathered light of the old Gaussians are
    /// dropped: measure anew.
    ///
    /// # Errors
    /// When the device has no memory left, or [`GpuError::Misuse`] for a source that does not exist.
    pub fn rebuild(&mut self, plan: &DensityPlan) -> Result<(), GpuError> {
        let mut recorder = self.gpu.record();
        self.state.model = density::gather(&mut recorder, &self.state.model, plan)?;
        self.state.density = self.gpu.buffer("density statistics", plan.gaussians.len())?;
        recorder.clear(&self.state.density);
        recorder.submit()?;
        self.state.measured.forget_values();
        Ok(())
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
        physical: bool,
    ) -> Result<(), GpuError> {
        let weights = step.weights.parameters;
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
            self.light.backward(recorder, model, &step.weights.light, indirect, self.globals_gradient);
            self.updater.step_globals(recorder, model, &sums, &step.sizes, step.counts);
        }
        Ok(())
    }
}
