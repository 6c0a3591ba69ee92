//! Joint optimisation of geometry, materials and light: initialisation, schedule, density control, checkpoints,
//! trainer, evaluation and rendering.

pub mod calibration;
mod checkpoint;
pub mod complexity;
mod context;
mod crop;
mod dataset;
pub mod delight;
mod density;
mod error;
pub mod eval;
mod exposure;
mod import;
mod initial;
mod known_light;
mod light_colour;
mod light_groups;
mod lights;
mod materials;
mod memory;
pub mod palette;
pub mod render;
mod sampling_rate;
mod schedule;
mod state;
mod surroundings;
mod system_memory;
pub mod time_budget;
mod trainer;
pub mod trust;
mod unseen;
mod world_up;

pub use checkpoint::planned_config;
pub use dataset::DecodingStats;
pub use error::TrainError;
pub use import::{
    colour_matrix_of_card, import_for_training, import_in_world, import_options_of_card,
    light_groups_of_card, light_like_card, turntable_of_card,
};
pub use known_light::illuminate;
pub use memory::{MemoryBudget, MemoryEstimate, PhotographSizes};
pub use system_memory::{available_memory, cgroup_limit};
pub use trainer::{PreparedTraining, Progress, StepReport, Trainer};
pub use world_up::{up_of_card, up_of_checkpoint};
