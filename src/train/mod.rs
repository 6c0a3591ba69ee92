//! The joint optimisation: objective, optimiser, density control, schedule, checkpoints, trainer.

mod checkpoint;
mod config;
mod dataset;
mod density;
mod initial;
mod materials;
pub mod objective;
mod optimiser;
mod state;
mod step;
mod trainer;

pub use config::{LabelSource, LearningRates, LossWeights, Preset, TrainConfig, TrainOverrides};
pub use trainer::{Progress, StepReport, TrainError, Trainer};
