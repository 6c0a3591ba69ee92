//! Environments on the device: tables of a finished light, and the operators of one that trains.

mod tables;
#[cfg(test)]
mod tests;
mod training;

pub use tables::{Constants, LightBuffers, TablesUniform};
pub use training::TrainingLight;
