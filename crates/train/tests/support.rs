//! Small trainings of small photographs, shared by the tests of trainings.

use relume_capture::Capture;
use relume_engine::Device;
use relume_spec::training::{Preset, TrainConfig, TrainOverrides};
use relume_train::{StepReport, Trainer};

/// A draft of 40 px with a few hundred Gaussians.
pub fn overrides(iterations: u32) -> TrainOverrides {
    TrainOverrides {
        iterations: Some(iterations),
        resolution: Some(40),
        initial_gaussians: Some(300),
        max_gaussians: Some(500),
        probe_directions: Some(16),
        ..Default::default()
    }
}

/// As [`overrides`] with 60 steps, and with measurements and checkpoints between them.
pub fn short_overrides() -> TrainOverrides {
    TrainOverrides { probe_every: Some(13), checkpoint_every: Some(17), ..overrides(60) }
}

pub fn trainer(capture: &Capture, overrides: &TrainOverrides, device: &Device) -> Trainer {
    Trainer::new(capture, TrainConfig::new(Preset::Draft, overrides).unwrap(), device).unwrap()
}

/// Trains to the end.
pub fn finish(trainer: &mut Trainer) -> Vec<StepReport> {
    let mut reports = Vec::new();
    while !trainer.is_done() {
        reports.push(trainer.step().unwrap());
    }
    reports
}
