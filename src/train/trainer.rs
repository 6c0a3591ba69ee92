//! The trainer: one object that owns everything a step needs.

use std::time::Instant;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::capture::Capture;
use crate::engine::Device;
use crate::engine::gpu::GpuError;
use crate::light::{EnvOperators, TableResolution};
use crate::scene::{Field, Model};
use crate::train::backend::{Backend, StepTask};
use crate::train::complexity::{self, state::ComplexityState};
use crate::train::dataset::{Dataset, Photo};
use crate::train::on_cpu::OnCpu;
use crate::train::on_gpu::OnGpu;
use crate::train::optimiser::StepSizes;
use crate::train::state::{Course, Learned};
use crate::train::step::{self, StepContext};
use crate::train::{LabelSource, TrainConfig, checkpoint, initial, materials};

/// Fewest photographs worth training on.
const LEAST_VIEWS: usize = 3;
/// Steps between the states a roll-back can return to.
const SNAPSHOT_EVERY: u32 = 50;
/// Roll-backs in a row after which the optimisation is given up.
const MOST_ROLLBACKS: u32 = 6;
/// Steps between density rounds.
const REFINE_EVERY: u32 = 100;

/// Why a training cannot start or go on.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A setting or the capture cannot be trained on; the message names what.
    #[error("{0}")]
    Invalid(String),
    /// A checkpoint could not be read; the message names the field.
    #[error("checkpoint: {0}")]
    Checkpoint(String),
    /// Loss or gradients stayed non-finite through every roll-back.
    #[error("optimisation diverged at step {step}: still not finite after {MOST_ROLLBACKS} roll-backs")]
    Diverged {
        /// The step that could not be passed.
        step: u32,
    },
    /// The device failed; the training can go on from its last checkpoint, here or elsewhere.
    #[error(transparent)]
    Device(#[from] GpuError),
}

/// What one step did.
#[derive(Debug, Clone, PartialEq)]
pub struct StepReport {
    /// Steps done so far.
    pub step: u32,
    /// The objective.
    pub loss: f32,
    /// PSNR on this step's photograph, dB: physically based branch, or the radiance branch during its warm-up.
    pub psnr: f32,
    /// Gaussians now.
    pub gaussians: usize,
    /// Something a user should know, e.g. a roll-back after a non-finite loss.
    pub warning: Option<String>,
}

/// Where a training stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Steps done.
    pub step: u32,
    /// Steps in all.
    pub total: u32,
}

/// A training in progress. The same capture, configuration and seed give the same bytes on the CPU engine; on a GPU
/// sums are taken in no fixed order, and the result agrees to the last digits only.
pub struct Trainer {
    config: TrainConfig,
    data: Dataset,
    operators: EnvOperators,
    course: Course,
    kept: Course,
    backend: Box<dyn Backend>,
    rollbacks: u32,
}

impl Trainer {
    /// Starts from nothing.
    ///
    /// # Errors
    /// [`TrainError::Invalid`] names what cannot be trained on, [`TrainError::Device`] what the device lacks.
    pub fn new(capture: &Capture, config: TrainConfig, device: &Device) -> Result<Self, TrainError> {
        let data = prepare(capture, &config)?;
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let model = initial::model(capture, &data, &config, &mut rng);
        let course = Course {
            step: 0,
            order: (0..data.full.len() as u32).collect(),
            cursor: data.full.len() as u32,
            rng,
            rate_factor: 1.0,
            seconds: 0.0,
            complexity: ComplexityState::default(),
        };
        Self::assemble(config, data, course, Learned::new(model), device)
    }

    /// Goes on from [`Trainer::checkpoint`] bytes, on whatever device; on the CPU engine bit for bit.
    ///
    /// # Errors
    /// [`TrainError::Checkpoint`] names what does not fit, [`TrainError::Invalid`] what cannot be trained on.
    pub fn resume(
        capture: &Capture,
        config: TrainConfig,
        bytes: &[u8],
        device: &Device,
    ) -> Result<Self, TrainError> {
        let data = prepare(capture, &config)?;
        let (course, learned) = checkpoint::decode(bytes, &config)?;
        if course.order.len() != data.full.len() {
            return Err(TrainError::Checkpoint("order: was made with another number of photographs".into()));
        }
        Self::assemble(config, data, course, learned, device)
    }

    fn assemble(
        config: TrainConfig,
        data: Dataset,
        course: Course,
        learned: Learned,
        device: &Device,
    ) -> Result<Self, TrainError> {
        let operators = operators_of(&learned.model);
        let backend: Box<dyn Backend> = match device {
            Device::Cpu => Box::new(OnCpu::new(learned)),
            Device::Gpu(gpu) => {
                let pixels = data.full.iter().map(|photo| photo.pixels.len()).max().unwrap_or(0);
                Box::new(OnGpu::new(gpu, &config, &operators, learned, pixels)?)
            }
        };
        Ok(Self { kept: course.clone(), config, data, operators, course, backend, rollbacks: 0 })
    }

    fn context(&self) -> StepContext<'_> {
        StepContext {
            config: &self.config,
            operators: &self.operators,
            background: self.data.background,
            has_alpha: self.data.has_alpha,
            progress: self.course.step as f32 / self.config.iterations as f32,
        }
    }

    /// One optimisation step.
    ///
    /// A non-finite loss or gradient returns to the last good state with smaller steps and says so in the report.
    ///
    /// # Errors
    /// [`TrainError::Diverged`] when that did not help either, [`TrainError::Device`] when the device failed.
    pub fn step(&mut self) -> Result<StepReport, TrainError> {
        let start = Instant::now();
        self.prepare_step()?;
        let photo = self.next_photo();
        let progress = self.context().progress;
        let material = self.course.step >= self.config.warm_up_steps();
        let half = progress < self.config.half_resolution;
        let learned = self.config.labels != LabelSource::Probes;
        let mut sizes = StepSizes::new(&self.config.rates, progress, material, learned);
        if self.is_dielectric() {
            sizes.fields[Field::MetalLogit as usize] = 0.0;
        }
        if !self.config.sheen {
            sizes.fields[Field::Sheen as usize] = 0.0;
        }
        let next = self.course.step + 1;
        // Spelled out, not `self.context()`: the backend is borrowed beside it.
        let context = StepContext {
            config: &self.config,
            operators: &self.operators,
            background: self.data.background,
            has_alpha: self.data.has_alpha,
            progress,
        };
        let value = self.backend.step(&StepTask {
            context,
            photo: photo_at(&self.data, photo, half),
            photo_key: (photo, half),
            material,
            sizes: sizes.scaled(self.course.rate_factor),
            ages: [next, next.saturating_sub(self.config.warm_up_steps()).max(1)],
        })?;
        if !value.finite {
            return self.roll_back();
        }
        let psnr = -10.0 * value.mse.max(1e-10).log10();
        self.course.complexity.record(u32::from(material) + 2 * u32::from(half), psnr);
        self.course.step = next;
        self.refine()?;
        if self.is_done() {
            self.decide()?;
        }
        self.course.seconds += start.elapsed().as_secs_f64();
        if self.is_snapshot_step() {
            if !self.backend.keep()? {
                return self.roll_back();
            }
            self.kept = self.course.clone();
            self.rollbacks = 0;
        }
        Ok(StepReport {
            step: self.course.step,
            loss: value.loss,
            psnr,
            gaussians: self.backend.gaussians(),
            warning: None,
        })
    }

    fn is_snapshot_step(&self) -> bool {
        let step = self.course.step;
        step.is_multiple_of(SNAPSHOT_EVERY) || step.is_multiple_of(self.config.checkpoint_every)
    }

    fn roll_back(&mut self) -> Result<StepReport, TrainError> {
        let failed = self.course.step;
        self.rollbacks += 1;
        if self.rollbacks > MOST_ROLLBACKS {
            return Err(TrainError::Diverged { step: failed });
        }
        self.backend.restore()?;
        self.course = self.kept.clone();
        self.course.rate_factor *= 0.5f32.powi(self.rollbacks as i32);
        let factor = self.course.rate_factor;
        let step = self.course.step;
        Ok(StepReport {
            step,
            loss: f32::MAX,
            psnr: 0.0,
            gaussians: self.backend.gaussians(),
            warning: Some(format!(
                "step {failed} was not finite: back to step {step} with step sizes at {factor} of the schedule"
            )),
        })
    }

    /// True when the training measures visibility, for labels or for the light that bounces.
    fn measures(&self) -> bool {
        let uses_probes = matches!(self.config.labels, LabelSource::Probes | LabelSource::Both);
        uses_probes || self.config.bounces > 0
    }

    /// What has to happen before certain steps: materials start, probes are refreshed.
    fn prepare_step(&mut self) -> Result<(), TrainError> {
        let (step, warm_up) = (self.course.step, self.config.warm_up_steps());
        if step == warm_up {
            let mut learned = self.backend.learned()?.into_owned();
            materials::initialise(&mut learned);
            if self.is_dielectric() {
                complexity::hold_dielectric(&mut learned);
            }
            self.backend.load(learned)?;
        }
        if self.measures() && step >= warm_up && (step - warm_up).is_multiple_of(self.config.probe_every) {
            self.refresh_probes(step == warm_up)?;
        }
        if self.config.is_albedo_round(step) {
            self.take_light_out()?;
        }
        self.decide()
    }

    fn take_light_out(&mut self) -> Result<(), TrainError> {
        if self.measures() {
            self.refresh_probes(false)?;
        }
        let learned = self.backend.learned()?;
        if learned.model.check().is_err() {
            // The next step rolls back, and comes past here again.
            return Ok(());
        }
        let mut learned = learned.into_owned();
        let normals = step::normals(&learned);
        materials::restart_albedo(&mut learned, &self.operators, &normals);
        if self.is_dielectric() {
            complexity::hold_dielectric(&mut learned);
        }
        self.backend.load(learned)
    }

    /// True when metalness is not learned.
    fn is_dielectric(&self) -> bool {
        !self.config.metalness || self.course.complexity.is_dielectric
    }

    /// Makes the model as small as the scene allows, if a decision is due.
    fn decide(&mut self) -> Result<(), TrainError> {
        let steps = self.course.step;
        let Some(point) = self.course.complexity.due(&self.config, steps) else { return Ok(()) };
        let learned = self.backend.learned()?;
        if learned.model.check().is_err() {
            // The next step rolls back, and comes past here again.
            return Ok(());
        }
        let mut learned = learned.into_owned();
        let mut ledger = self.course.complexity.clone();
        ledger.decide(point, &self.context(), steps, &self.data.full, &mut learned);
        self.course.complexity = ledger;
        if learned.model.gaussians.visibility_order() != self.operators.order() {
            self.operators = operators_of(&learned.model);
        }
        self.backend.reshape(learned, &self.operators)?;
        self.kept = self.course.clone();
        Ok(())
    }

    fn refresh_probes(&mut self, twice: bool) -> Result<(), TrainError> {
        let context = StepContext {
            config: &self.config,
            operators: &self.operators,
            background: self.data.background,
            has_alpha: self.data.has_alpha,
            progress: 0.0,
        };
        self.backend.refresh_probes(&context, twice)
    }

    fn next_photo(&mut self) -> usize {
        let course = &mut self.course;
        if course.cursor as usize >= course.order.len() {
            course.order.shuffle(&mut course.rng);
            course.cursor = 0;
        }
        course.cursor += 1;
        course.order[course.cursor as usize - 1] as usize
    }

    fn refine(&mut self) -> Result<(), TrainError> {
        let (step, total) = (self.course.step, self.config.iterations);
        let last = (self.config.densify_until * total as f32) as u32;
        let first = (total / 50).max(50);
        if step < first || step > last || !step.is_multiple_of(REFINE_EVERY.min((total / 15).max(10))) {
            return Ok(());
        }
        // The budget opens with the square root of progress, so that early Gaussians settle first.
        let share = ((step - first) as f32 / (last - first).max(1) as f32).sqrt();
        let (low, high) = (self.config.initial_gaussians as f32, self.config.max_gaussians as f32);
        self.course.complexity.before_round(&self.config, step, self.backend.gaussians());
        let most = self.course.complexity.most_gaussians.unwrap_or(u32::MAX) as usize;
        let budget = ((low + (high - low) * share) as usize).min(most);
        let eyes = (!self.data.has_alpha).then(|| self.data.camera_centres());
        self.backend.refine(budget, eyes.as_deref())?;
        if step > self.config.warm_up_steps() && self.measures() {
            // New Gaussians need labels and light of their own.
            self.refresh_probes(false)?;
        }
        Ok(())
    }

    /// Where it stands.
    pub fn progress(&self) -> Progress {
        Progress { step: self.course.step, total: self.config.iterations }
    }

    /// True when every step is done.
    pub fn is_done(&self) -> bool {
        self.course.step >= self.config.iterations
    }

    /// The configuration in force.
    pub fn config(&self) -> &TrainConfig {
        &self.config
    }

    /// Everything a resume needs, as one safetensors file with a versioned header.
    ///
    /// # Errors
    /// When the state is not finite (a poisoned checkpoint is never written) or the device failed.
    pub fn checkpoint(&self) -> Result<Vec<u8>, TrainError> {
        checkpoint::encode(&self.course, self.backend.learned()?.as_ref(), &self.config)
    }

    /// The model as it is now, with its card.
    ///
    /// # Errors
    /// [`TrainError::Device`] when the device failed.
    pub fn model(&self) -> Result<Model, TrainError> {
        let mut model = self.backend.learned()?.model.clone();
        model.card = serde_json::json!({
            "relume_version": env!("CARGO_PKG_VERSION"),
            "engine": self.backend.engine(),
            "steps": self.course.step,
            "gaussians": model.gaussians.len(),
            "photographs": self.data.full.len(),
            "has_alpha": self.data.has_alpha,
            "complexity": self.course.complexity.card(&self.config),
            "config": self.config,
        });
        Ok(model)
    }

    /// Seconds spent in steps so far, over all runs.
    pub fn seconds(&self) -> f64 {
        self.course.seconds
    }
}

fn prepare(capture: &Capture, config: &TrainConfig) -> Result<Dataset, TrainError> {
    if capture.train.len() < LEAST_VIEWS {
        let n = capture.train.len();
        return Err(TrainError::Invalid(format!(
            "capture: {n} usable training photographs, at least {LEAST_VIEWS} are needed"
        )));
    }
    if config.light.is_some() && capture.lit_by.is_none() {
        return Err(TrainError::Invalid("light: the capture came without the map it names".into()));
    }
    Ok(Dataset::new(capture, config.resolution))
}

/// The operators for a model's environment and visibility.
fn operators_of(model: &Model) -> EnvOperators {
    let order = model.gaussians.visibility_order();
    EnvOperators::new(model.env_width, model.env_height, order, TableResolution::TRAINING)
}

fn photo_at(data: &Dataset, index: usize, half: bool) -> &Photo {
    if half { &data.half[index] } else { &data.full[index] }
}

#[cfg(test)]
mod tests;
