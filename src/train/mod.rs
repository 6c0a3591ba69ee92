//! The joint optimisation: objective, optimiser, density control, schedule, checkpoints, trainer.

mod config;
pub mod objective;
mod trainer;

pub use config::{LabelSource, Preset, TrainConfig, TrainOverrides};
pub use trainer::{Progress, StepReport, TrainError, Trainer};
