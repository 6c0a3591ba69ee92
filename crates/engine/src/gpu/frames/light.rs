//! A light prepared for a model, in device memory.

use std::sync::OnceLock;

use crate::gpu::Buffer;
use crate::gpu::light::LightBuffers;
use crate::gpu::rays::EnvironmentBuffers;

/// A light in device memory, with what the model's surfaces send back under it.
pub(super) struct GpuFrameLight {
    /// Its tables.
    pub buffers: LightBuffers,
    /// Light that surfaces send each other, then the share of each light beside the tables that arrives.
    pub gathered: Option<Buffer<f32>>,
    /// What rays make of it.
    pub by_rays: RayResources,
}

/// What rays make of a light, once they were needed.
#[derive(Default)]
pub(super) struct RayResources {
    /// Tables of what is left without the sharp lights.
    pub rest: OnceLock<LightBuffers>,
    /// The environment to draw directions from.
    pub environment: OnceLock<EnvironmentBuffers>,
}

impl GpuFrameLight {
    /// One that no ray was asked for yet.
    pub fn new(buffers: LightBuffers, gathered: Option<Buffer<f32>>) -> Self {
        Self { buffers, gathered, by_rays: RayResources::default() }
    }
}
