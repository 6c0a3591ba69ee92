//! A frame of the tiers that run on the CPU engine whatever the device.

use crate::engine::FrameJob;
use crate::engine::cpu::{AttributeSource, SurfaceShader};

/// A frame that the CPU engine makes, whatever the device: the model under a light, and what is wanted.
pub(super) struct Job<'a> {
    pub(super) source: AttributeSource<'a>,
    pub(super) shader: SurfaceShader<'a>,
    pub(super) frame: FrameJob<'a>,
}
