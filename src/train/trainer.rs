//! The trainer: one object that owns everything a step needs.

use std::time::Instant;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::capture::Capture;
use crate::light::{EnvOperators, TableResolution};
use crate::scene::Model;
use crate::train::dataset::{Dataset, Photo};
use crate::train::density::{self, DensityStats};
use crate::train::optimiser::{Moments, StepSizes};
use crate::train::state::TrainState;
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

/// A training in progress. The same capture, configuration and seed give the same bytes.
pub struct Trainer {
    config: TrainConfig,
    data: Dataset,
    operators: EnvOperators,
    state: TrainState,
    last_good: TrainState,
    rollbacks: u32,
}

impl Trainer {
    /// Starts from nothing.
    ///
    /// # Errors
    /// [`TrainError::Invalid`] names what cannot be trained on.
    pub fn new(capture: &Capture, config: TrainConfig) -> Result<Self, TrainError> {
        let data = prepare(capture, &config)?;
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let model = initial::model(capture, &data, &config, &mut rng);
        let state = TrainState {
            step: 0,
            moments: Moments::zeroed(&model),
            density: DensityStats::zeroed(model.gaussians.len()),
            labels: Vec::new(),
            gathered: Vec::new(),
            order: (0..data.full.len() as u32).collect(),
            cursor: data.full.len() as u32,
            rng,
            rate_factor: 1.0,
            seconds: 0.0,
            model,
        };
        Ok(Self::assemble(config, data, state))
    }

    /// Goes on from [`Trainer::checkpoint`] bytes, bit for bit.
    ///
    /// # Errors
    /// [`TrainError::Checkpoint`] names what does not fit, [`TrainError::Invalid`] what cannot be trained on.
    pub fn resume(capture: &Capture, config: TrainConfig, bytes: &[u8]) -> Result<Self, TrainError> {
        let data = prepare(capture, &config)?;
        let state = checkpoint::decode(bytes, &config)?;
        if state.order.len() != data.full.len() {
            return Err(TrainError::Checkpoint("order: was made with another number of photographs".into()));
        }
        Ok(Self::assemble(config, data, state))
    }

    fn assemble(config: TrainConfig, data: Dataset, state: TrainState) -> Self {
        let rows = config.environment_rows as usize;
        let order = config.visibility_order as usize;
        let operators = EnvOperators::new(rows * 2, rows, order, TableResolution::TRAINING);
        Self { last_good: state.clone(), config, data, operators, state, rollbacks: 0 }
    }

    /// One optimisation step.
    ///
    /// A non-finite loss or gradient returns to the last good state with smaller steps and says so in the report.
    ///
    /// # Errors
    /// [`TrainError::Diverged`] when that did not help either.
    pub fn step(&mut self) -> Result<StepReport, TrainError> {
        let start = Instant::now();
        self.prepare_step();
        let photo = self.next_photo();
        let progress = self.state.step as f32 / self.config.iterations as f32;
        let material = self.state.step >= self.config.warm_up_steps();
        let context = StepContext {
            config: &self.config,
            operators: &self.operators,
            background: self.data.background,
            has_alpha: self.data.has_alpha,
            progress,
        };
        let photo = photo_at(&self.data, photo, progress < self.config.half_resolution);
        let outcome = if material {
            step::material(&context, &self.state, photo)
        } else {
            step::radiance(&context, &self.state, photo)
        };
        if !(outcome.loss.is_finite() && outcome.gradients.is_finite()) {
            return self.roll_back();
        }
        self.state.density.record(&outcome.gradients);
        let learned = self.config.labels != LabelSource::Probes;
        let sizes =
            StepSizes::new(&self.config.rates, progress, material, learned).scaled(self.state.rate_factor);
        self.state.step += 1;
        let ages = [self.state.step, self.state.step.saturating_sub(self.config.warm_up_steps()).max(1)];
        self.state.moments.step(&mut self.state.model, &outcome.gradients, &sizes, ages);
        self.refine();
        self.state.seconds += start.elapsed().as_secs_f64();
        if self.is_snapshot_step() {
            if !self.state.model.gaussians.is_finite() {
                return self.roll_back();
            }
            self.last_good = self.state.clone();
            self.rollbacks = 0;
        }
        Ok(StepReport {
            step: self.state.step,
            loss: outcome.loss,
            psnr: -10.0 * outcome.mse.max(1e-10).log10(),
            gaussians: self.state.model.gaussians.len(),
            warning: None,
        })
    }

    fn is_snapshot_step(&self) -> bool {
        let step = self.state.step;
        step.is_multiple_of(SNAPSHOT_EVERY) || step.is_multiple_of(self.config.checkpoint_every)
    }

    fn roll_back(&mut self) -> Result<StepReport, TrainError> {
        let failed = self.state.step;
        self.rollbacks += 1;
        if self.rollbacks > MOST_ROLLBACKS {
            return Err(TrainError::Diverged { step: failed });
        }
        self.state = self.last_good.clone();
        self.state.rate_factor *= 0.5f32.powi(self.rollbacks as i32);
        let factor = self.state.rate_factor;
        let step = self.state.step;
        Ok(StepReport {
            step,
            loss: f32::MAX,
            psnr: 0.0,
            gaussians: self.state.model.gaussians.len(),
            warning: Some(format!(
                "step {failed} was not finite: back to step {step} with step sizes at {factor} of the schedule"
            )),
        })
    }

    /// What has to happen before certain steps: materials start, probes are refreshed.
    fn prepare_step(&mut self) {
        let (step, warm_up) = (self.state.step, self.config.warm_up_steps());
        if step == warm_up {
            materials::initialise(&mut self.state.model);
        }
        let uses_probes = matches!(self.config.labels, LabelSource::Probes | LabelSource::Both);
        let needs = uses_probes || self.config.bounces > 0;
        if needs && step >= warm_up && (step - warm_up).is_multiple_of(self.config.probe_every) {
            let twice = step == warm_up;
            step::refresh_probes(&self.config, &self.operators, &mut self.state, twice);
        }
    }

    fn next_photo(&mut self) -> usize {
        let state = &mut self.state;
        if state.cursor as usize >= state.order.len() {
            state.order.shuffle(&mut state.rng);
            state.cursor = 0;
        }
        state.cursor += 1;
        state.order[state.cursor as usize - 1] as usize
    }

    fn refine(&mut self) {
        let (step, total) = (self.state.step, self.config.iterations);
        let last = (self.config.densify_until * total as f32) as u32;
        let first = (total / 50).max(50);
        if step < first || step > last || !step.is_multiple_of(REFINE_EVERY.min((total / 15).max(10))) {
            return;
        }
        // The budget opens with the square root of progress, so that early Gaussians settle first.
        let share = ((step - first) as f32 / (last - first).max(1) as f32).sqrt();
        let (low, high) = (self.config.initial_gaussians as f32, self.config.max_gaussians as f32);
        let budget = (low + (high - low) * share) as usize;
        let state = &mut self.state;
        let eyes = (!self.data.has_alpha).then(|| self.data.eyes());
        let TrainState { model, moments, density, .. } = state;
        density::refine(model, moments, density, budget, eyes.as_deref());
        if step >= self.config.warm_up_steps() && !state.labels.is_empty() {
            // New Gaussians need labels and light of their own.
            step::refresh_probes(&self.config, &self.operators, state, false);
        }
    }

    /// Where it stands.
    pub fn progress(&self) -> Progress {
        Progress { step: self.state.step, total: self.config.iterations }
    }

    /// True when every step is done.
    pub fn is_done(&self) -> bool {
        self.state.step >= self.config.iterations
    }

    /// The configuration in force.
    pub fn config(&self) -> &TrainConfig {
        &self.config
    }

    /// Everything a bit-exact resume needs, as one safetensors file with a versioned header.
    ///
    /// # Errors
    /// When the state is not finite: a poisoned checkpoint is never written.
    pub fn checkpoint(&self) -> Result<Vec<u8>, TrainError> {
        checkpoint::encode(&self.state, &self.config)
    }

    /// The model as it is now, with its card.
    pub fn model(&self) -> Model {
        let mut model = self.state.model.clone();
        model.card = serde_json::json!({
            "relume_version": env!("CARGO_PKG_VERSION"),
            "engine": "cpu",
            "steps": self.state.step,
            "gaussians": model.gaussians.len(),
            "photographs": self.data.full.len(),
            "has_alpha": self.data.has_alpha,
            "config": self.config,
        });
        model
    }

    /// Seconds spent in steps so far, over all runs.
    pub fn seconds(&self) -> f64 {
        self.state.seconds
    }
}

fn prepare(capture: &Capture, config: &TrainConfig) -> Result<Dataset, TrainError> {
    if capture.train.len() < LEAST_VIEWS {
        let n = capture.train.len();
        return Err(TrainError::Invalid(format!(
            "capture: {n} usable training photographs, at least {LEAST_VIEWS} are needed"
        )));
    }
    Ok(Dataset::new(capture, config.resolution))
}

fn photo_at(data: &Dataset, index: usize, half: bool) -> &Photo {
    if half { &data.half[index] } else { &data.full[index] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::{SyntheticOptions, synthetic};
    use crate::train::{Preset, TrainOverrides};

    #[test]
    fn a_poisoned_step_is_rolled_back_with_smaller_steps_and_said() {
        let options = SyntheticOptions {
            train_views: 3,
            test_views: 1,
            size: 24,
            paths: 4,
            relit: Default::default(),
            ..Default::default()
        };
        let overrides = TrainOverrides {
            resolution: Some(24),
            initial_gaussians: Some(64),
            max_gaussians: Some(64),
            warm_up: Some(0.0),
            probe_directions: Some(8),
            ..Default::default()
        };
        let config = TrainConfig::new(Preset::Draft, &overrides).unwrap();
        let mut trainer = Trainer::new(&synthetic(&options).unwrap(), config).unwrap();
        assert_eq!(trainer.step().unwrap().warning, None, "the control: a sound step is taken");
        trainer.state.model.env_raw[5] = [f32::NAN; 3];
        assert!(trainer.checkpoint().is_err(), "a poisoned checkpoint must not be written");
        let warning = trainer.step().unwrap().warning.unwrap();
        assert!(warning.contains("back to step 0"), "{warning}");
        assert_eq!(trainer.state.rate_factor, 0.5);
        assert!(trainer.state.model.check().is_ok());
    }
}
