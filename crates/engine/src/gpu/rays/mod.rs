//! Light that is traced along rays: small lights with a shadow each, and a whole environment by Monte-Carlo.
//! Ports of crates/engine/src/cpu/pixel_light.rs (tier `high`) and crates/engine/src/cpu/monte_carlo.rs (tier
//! `monte_carlo`).

mod monte_carlo;
mod points;
mod shadows;
mod tree;

pub use monte_carlo::{EnvironmentBuffers, Samples};
pub use tree::TreeBuffers;

use crate::gpu::Buffer;
use crate::gpu::raster::BlendEnd;

/// Memory that successive frames share.
#[derive(Debug, Default)]
pub struct RayMemory {
    /// Camera depth of each pixel's surface.
    depths: Option<Buffer<f32>>,
    /// Two groups per Gaussian: its reflection of one light.
    rows: Option<Buffer<[f32; 4]>>,
    /// The same per pixel, planar.
    reflected: Option<Buffer<[f32; 4]>>,
    ends: Option<Buffer<BlendEnd>>,
    /// Diffuse and specular radiance of each pixel, planar, times coverage.
    sent: Option<Buffer<[f32; 4]>>,
}
