//! Inputs of the decisions during a training: configuration, light operators, capture properties.

use crate::schedule;
use relume_engine::{Branches, Photo, PhotoLights, TrainState, evaluation};
use relume_scene::light::EnvOperators;
use relume_spec::training::TrainConfig;

/// The parts of a training that stay the same for every step.
#[derive(Debug, Clone, Copy)]
pub struct StepContext<'a> {
    /// The configuration.
    pub config: &'a TrainConfig,
    /// Operators of the training environment.
    pub operators: &'a EnvOperators,
    /// Rotations of the photographs' light.
    pub lights: &'a PhotoLights,
    /// Display-referred background.
    pub background: [f32; 3],
    /// Whether the capture has masks.
    pub has_alpha: bool,
}

impl StepContext<'_> {
    /// The physically based branch, rendered for one photograph, display-referred.
    pub fn physical_image(&self, state: &TrainState, photo: &Photo) -> Vec<[f32; 3]> {
        evaluation::physical_image(state, self.operators, photo, self.branches(), self.background)
    }

    /// Mean squared error of the physically based branch on one photograph.
    pub fn physical_error(&self, state: &TrainState, photo: &Photo) -> f32 {
        evaluation::physical_error(state, self.operators, photo, self.branches(), self.background)
    }

    /// Mean squared error of the radiance branch on one photograph.
    pub fn radiance_error(&self, state: &TrainState, photo: &Photo) -> f32 {
        evaluation::radiance_error(state, photo, self.background)
    }

    fn branches(&self) -> Branches {
        schedule::branches(self.config, self.config.iterations)
    }
}
