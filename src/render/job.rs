//! A frame of the tiers that ask along rays, on the CPU engine.

use crate::engine::FrameJob;
use crate::engine::cpu::{AttributeSource, SurfaceShader};

/// The model under a light, and what is wanted of it.
pub(super) struct Job<'a> {
    pub(super) source: AttributeSource<'a>,
    pub(super) shader: SurfaceShader<'a>,
    pub(super) frame: FrameJob<'a>,
}
