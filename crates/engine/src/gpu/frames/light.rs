//! A light prepared for a model, in device memory.

use std::sync::{Arc, OnceLock};

use crate::gpu::Buffer;
use crate::gpu::frames::GpuFrameRenderer;
use crate::gpu::light::LightBuffers;
use crate::gpu::rays::EnvironmentBuffers;

/// A light in device memory, with the light that the model's surfaces send each other under it.
pub(super) struct GpuFrameLight {
    /// The model for which it is prepared.
    pub renderer: Arc<GpuFrameRenderer>,
    /// Its tables.
    pub buffers: LightBuffers,
    /// Gathered light, then the arriving share of each dominant light.
    pub gathered: Option<Buffer<f32>>,
    /// The same with the shadows of the sky.
    pub with_sky_shadows: Option<Buffer<f32>>,
    /// Its resources for rays.
    pub by_rays: RayResources,
}

/// Resources of a light for rays, created on first use.
#[derive(Default)]
pub(super) struct RayResources {
    /// The environment without the sharp lights.
    pub rest: OnceLock<RestOfLight>,
    /// The environment as a sampler of directions.
    pub environment: OnceLock<EnvironmentBuffers>,
}

/// An environment without its sharp lights.
pub(super) struct RestOfLight {
    /// Its tables.
    pub buffers: LightBuffers,
    /// Gathered light of the whole environment with the shadows of the sky of the rest, then the arriving shares.
    pub with_sky_shadows: Option<Buffer<f32>>,
}
