//! The trainer, which owns everything that a training step needs.

mod card;
mod crop;
mod density_rounds;
mod events;
mod photographed_views;
mod photographs;
mod planned;
mod preparation;
mod step_results;
mod step_tracker;

pub use preparation::PreparedTraining;

use std::sync::Arc;
use std::time::Instant;

use crate::context::StepContext;
use crate::dataset::{Dataset, DecodingStats};
use crate::error::{MAX_ROLLBACKS, TrainError};
use crate::state::ScheduleState;
use crate::{checkpoint, schedule};
use relume_capture::Capture;
use relume_engine::{Device, PhotoId, PhotoSize, Step, StepCounts, TrainingEngine, TrainingLimits};
use relume_scene::Field;
use relume_scene::light::{EnvOperators, LightColour};
use relume_spec::training::TrainConfig;

/// Number of steps between snapshots for roll-backs.
const SNAPSHOT_EVERY: u32 = 50;

/// Report of one step.
#[derive(Debug, Clone, PartialEq)]
pub struct StepReport {
    /// Completed steps.
    pub step: u32,
    /// The step of `loss` and `psnr`: this step, or the previous one if the device is still working on this one.
    pub metrics_step: u32,
    /// Value of the objective at that step.
    pub loss: f32,
    /// PSNR on that step's photograph, dB: physically based branch, or the radiance branch during its warm-up.
    pub psnr: f32,
    /// Current number of Gaussians.
    pub gaussians: usize,
    /// A warning for the user, e.g. about a roll-back after a non-finite loss.
    pub warning: Option<String>,
}

/// Progress of a training.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Completed steps.
    pub step: u32,
    /// Total steps.
    pub total: u32,
}

/// A training in progress. Equal capture, configuration and seed give equal bytes on the CPU engine. On a GPU the
/// order of sums varies, so results agree only to the last digits.
pub struct Trainer {
    config: TrainConfig,
    data: Dataset,
    operators: Arc<EnvOperators>,
    schedule: ScheduleState,
    snapshot: ScheduleState,
    engine: Box<dyn TrainingEngine>,
    rollbacks: u32,
    tracker: step_tracker::StepTracker,
}

impl PreparedTraining {
    /// The trainer, with its state on `device`.
    ///
    /// # Errors
    /// [`TrainError::Device`] states what the device lacks.
    pub fn on(self, device: &Device) -> Result<Trainer, TrainError> {
        let Self { config, data, operators, schedule, state } = self;
        let limits = TrainingLimits {
            resolution: config.resolution,
            pixels: data.largest(),
            max_gaussians: config.max_gaussians.max(config.initial_gaussians),
            probe_directions: config.probe_directions,
        };
        let engine = device.training(state, &operators, &limits)?;
        Ok(Trainer {
            snapshot: schedule.clone(),
            config,
            data,
            operators,
            schedule,
            engine,
            rollbacks: 0,
            tracker: Default::default(),
        })
    }
}

impl Trainer {
    /// Starts a new training.
    ///
    /// # Errors
    /// [`TrainError::Invalid`] names the unsuitable setting or input, [`TrainError::Device`] states what the device
    /// lacks.
    pub fn new(capture: &Capture, config: TrainConfig, device: &Device) -> Result<Self, TrainError> {
        PreparedTraining::new(capture, config)?.on(device)
    }

    /// Resumes from the bytes of [`Trainer::checkpoint`] on any device; on the CPU engine the result is
    /// bit-identical.
    ///
    /// # Errors
    /// [`TrainError::Checkpoint`] names what does not match, [`TrainError::Invalid`] the unsuitable setting or input.
    pub fn resume(
        capture: &Capture,
        config: TrainConfig,
        bytes: &[u8],
        device: &Device,
    ) -> Result<Self, TrainError> {
        PreparedTraining::resume(capture, config, bytes)?.on(device)
    }

    fn context(&self) -> StepContext<'_> {
        StepContext {
            config: &self.config,
            operators: &self.operators,
            lights: &self.data.lights,
            background: self.data.background,
            has_alpha: self.data.has_alpha,
        }
    }

    /// Performs one optimisation step.
    ///
    /// After a non-finite loss or gradient the trainer returns to the last snapshot with smaller steps, and the
    /// report has a warning.
    ///
    /// # Errors
    /// [`TrainError::Diverged`] if roll-backs did not help, [`TrainError::Device`] if the device failed.
    pub fn step(&mut self) -> Result<StepReport, TrainError> {
        let start = Instant::now();
        self.prepare_step()?;
        if self.tracker.non_finite_step.is_some() {
            return self.roll_back();
        }
        let photo = self.schedule.next_photo();
        let timeline = &self.schedule.timeline;
        let (progress, position) = (timeline.progress(self.schedule.step), self.schedule.position());
        let material_start = timeline.step_of(self.config.warm_up_steps());
        let branches = schedule::branches(&self.config, position);
        let size = schedule::photo_size(&self.config, position);
        let photo_id = PhotoId { index: photo, size, revision: self.schedule.revision() };
        let photo = self.photograph(photo_id);
        let mut sizes = schedule::step_sizes(&self.config, branches, progress);
        if self.is_dielectric() {
            sizes.fields[Field::MetalLogit as usize] = 0.0;
        }
        let relative = &self.data.relative_lights[photo.light.light.group];
        let light = relative.colour_of(self.schedule.light_colour.unwrap_or(LightColour::NEUTRAL));
        let mut weights =
            schedule::step_weights(&self.config, branches, progress, self.data.has_alpha, light);
        if self.data.lights.has_rotations() {
            weights.light = schedule::rotating_light_weights(weights.light);
        }
        if let Some(surroundings) = &self.schedule.surroundings {
            weights.light = schedule::weights_with_sources(weights.light, surroundings.source_share());
        }
        let next = self.schedule.step + 1;
        let material = next.saturating_sub(material_start).max(1);
        let sums = self.engine.step(&Step {
            photo: &photo,
            photo_id,
            background: self.data.background,
            branches,
            weights,
            sizes: sizes.scaled(self.schedule.rate_factor),
            counts: StepCounts { geometry: next, material },
        })?;
        let phase = u32::from(branches.is_physical()) + 2 * u32::from(size == PhotoSize::Half);
        self.record_step(phase, sums);
        if self.tracker.non_finite_step.is_some() {
            return self.roll_back();
        }
        self.schedule.step = next;
        self.refine()?;
        self.end()?;
        self.schedule.seconds += start.elapsed().as_secs_f64();
        self.take_snapshot()?;
        if self.tracker.non_finite_step.is_some() {
            return self.roll_back();
        }
        let known = self.latest_metrics()?;
        Ok(StepReport {
            step: self.schedule.step,
            metrics_step: known.step,
            loss: known.loss,
            psnr: known.psnr,
            gaussians: self.engine.gaussians(),
            warning: self.tracker.warning.take(),
        })
    }

    /// Makes the last decisions once all steps are completed.
    fn end(&mut self) -> Result<(), TrainError> {
        if self.is_done() {
            self.wait_for_steps()?;
            if self.tracker.non_finite_step.is_none() {
                self.decide()?;
            }
        }
        Ok(())
    }

    /// Takes a snapshot for roll-backs if one is due and the state is finite.
    fn take_snapshot(&mut self) -> Result<(), TrainError> {
        if self.is_snapshot_step() {
            let _span = tracing::info_span!("snapshot").entered();
            self.wait_for_steps()?;
            if self.tracker.non_finite_step.is_none() {
                if self.engine.snapshot()? {
                    self.snapshot = self.schedule.clone();
                    self.rollbacks = 0;
                } else {
                    self.tracker.non_finite_step = Some(self.schedule.step);
                }
            }
        }
        Ok(())
    }

    fn is_snapshot_step(&self) -> bool {
        let step = self.schedule.step;
        step.is_multiple_of(SNAPSHOT_EVERY) || step.is_multiple_of(self.config.checkpoint_every)
    }

    fn roll_back(&mut self) -> Result<StepReport, TrainError> {
        let failed = self.tracker.roll_back().unwrap_or(self.schedule.step);
        self.rollbacks += 1;
        if self.rollbacks > MAX_ROLLBACKS {
            return Err(TrainError::Diverged { step: failed });
        }
        self.engine.roll_back()?;
        let lights = self.engine.state()?.model.lights.clone();
        self.operators = Arc::new(self.operators.with_lights(&lights));
        // The plan is kept: time does not go back, and a repeated training has the whole plan from its start.
        let (timeline, budget) = (self.schedule.timeline.clone(), self.schedule.budget);
        self.schedule = ScheduleState { timeline, budget, ..self.snapshot.clone() };
        self.schedule.rate_factor *= 0.5f32.powi(self.rollbacks as i32);
        let factor = self.schedule.rate_factor;
        let step = self.schedule.step;
        Ok(StepReport {
            step,
            metrics_step: step,
            loss: f32::MAX,
            psnr: 0.0,
            gaussians: self.engine.gaussians(),
            warning: Some(format!(
                "step {failed} was not finite: rolled back to step {step}, with step sizes multiplied by {factor}"
            )),
        })
    }

    /// True when metalness is not learned.
    fn is_dielectric(&self) -> bool {
        !self.config.metalness || self.schedule.complexity.is_dielectric
    }

    /// Progress of the training.
    pub fn progress(&self) -> Progress {
        Progress { step: self.schedule.step, total: self.schedule.timeline.total() }
    }

    /// True when all steps are completed.
    pub fn is_done(&self) -> bool {
        self.schedule.step >= self.schedule.timeline.total()
    }

    /// Whether materials have been trained. A model cannot be relit before, or with a method that trains only colour.
    pub fn is_relightable(&self) -> bool {
        let position = self.schedule.position().min(self.config.iterations.saturating_sub(1));
        schedule::branches(&self.config, position).is_physical()
    }

    /// The effective configuration.
    pub fn config(&self) -> &TrainConfig {
        &self.config
    }

    /// The complete state for resuming, as a safetensors file with a versioned header.
    ///
    /// # Errors
    /// If the state is not finite (a checkpoint never contains NaN or infinity) or the device failed.
    pub fn checkpoint(&mut self) -> Result<Vec<u8>, TrainError> {
        self.wait_for_finite_state()?;
        checkpoint::encode(&self.schedule, self.engine.state()?.as_ref(), &self.config)
    }

    /// Statistics of the decoding for the steps of this run.
    pub fn decoding(&self) -> DecodingStats {
        self.data.decoding()
    }

    /// Seconds spent in steps so far, over all runs.
    pub fn seconds(&self) -> f64 {
        self.schedule.seconds
    }
}

#[cfg(test)]
mod room_tests;
#[cfg(test)]
mod tests;
