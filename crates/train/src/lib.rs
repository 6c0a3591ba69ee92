//! The joint optimisation: objective, optimiser, density control, schedule, checkpoints, trainer.

mod checkpoint;
pub mod complexity;
mod context;
mod crop;
mod dataset;
mod density;
mod error;
pub mod eval;
mod exposure;
mod import;
mod initial;
mod known_light;
mod light_colour;
mod lights;
mod materials;
mod memory;
pub mod render;
mod room;
mod schedule;
mod state;
mod trainer;

pub use dataset::DecodingStats;
pub use error::TrainError;
pub use import::import_for_training;
pub use known_light::illuminate;
pub use memory::{MemoryNeed, PhotographSizes, Room};
pub use room::{available_memory, own_group_limit};
pub use trainer::{Preparation, Progress, StepReport, Trainer};
