//! A training step in device memory.

use crate::gpu::{CameraUniform, DevicePhoto, ReadbackTicket, Submission};
use crate::photo_light::PhotoLight;
use crate::{Branches, StepCounts, StepSizes, StepWeights};
use relume_layout::channel::StepChannels;

/// A step with its photograph in device memory, so that it can be recorded again.
#[derive(Debug, Clone)]
pub(super) struct DeviceStep {
    pub(super) camera: CameraUniform,
    pub(super) photo: DevicePhoto,
    pub(super) light: PhotoLight,
    pub(super) channels: StepChannels,
    pub(super) background: [f32; 3],
    pub(super) branches: Branches,
    pub(super) weights: StepWeights,
    pub(super) sizes: StepSizes,
    pub(super) counts: StepCounts,
}

/// A submitted step.
pub(super) struct SubmittedStep {
    pub(super) step: DeviceStep,
    pub(super) submission: Submission,
    pub(super) losses: ReadbackTicket<f32>,
    pub(super) list_status: ReadbackTicket<u32>,
}

impl std::fmt::Debug for SubmittedStep {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Pending").field("step", &self.step).finish_non_exhaustive()
    }
}
