//! A light prepared for a model, in device memory.

use std::sync::OnceLock;

use crate::gpu::Buffer;
use crate::gpu::light::LightBuffers;
use crate::gpu::rays::EnvironmentBuffers;

/// A light in device memory, with the light that the model's surfaces send each other under it.
pub(super) struct GpuFrameLight {
    /// Its tables.
    pub buffers: LightBuffers,
    /// Gathered light, then the arriving share of each dominant light.
    pub gathered: Option<Buffer<f32>>,
    /// Its resources for rays.
    pub by_rays: RayResources,
}

/// Resources of a light for rays, created on first use.
#[derive(Default)]
pub(super) struct RayResources {
    /// Tables of the environment without the sharp lights.
    pub rest: OnceLock<LightBuffers>,
    /// The environment as a sampler of directions.
    pub environment: OnceLock<EnvironmentBuffers>,
}

impl GpuFrameLight {
    /// A light without resources for rays.
    pub fn new(buffers: LightBuffers, gathered: Option<Buffer<f32>>) -> Self {
        Self { buffers, gathered, by_rays: RayResources::default() }
    }
}
