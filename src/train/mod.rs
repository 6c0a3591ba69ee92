//! The joint optimisation: objective, optimiser, density control, schedule, checkpoints, trainer.

mod backend;
mod checkpoint;
pub mod complexity;
mod config;
mod dataset;
mod density;
mod import;
mod initial;
mod known_light;
mod materials;
pub mod objective;
mod on_cpu;
mod on_gpu;
mod optimiser;
mod state;
mod step;
mod trainer;
mod weights;

pub use config::{Complexity, LabelSource, Preset, Setting, TrainConfig, TrainOverrides};
pub use import::import_for_training;
pub use known_light::{Auto, KnownLight, LightExposure};
pub use trainer::{Progress, StepReport, TrainError, Trainer};
pub use weights::{LearningRates, LossWeights};
