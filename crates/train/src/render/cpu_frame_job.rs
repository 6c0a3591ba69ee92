//! A frame of the tiers that ask along rays, on the CPU engine.

use relume_engine::FrameJob;
use relume_engine::cpu::{AttributeSource, SurfaceShader};

/// The model under a light, and what is wanted of it.
pub(super) struct CpuFrameJob<'a> {
    pub(super) source: AttributeSource<'a>,
    pub(super) shader: SurfaceShader<'a>,
    pub(super) frame: FrameJob<'a>,
}
