//! Light that is looked for along rays: small lights with a shadow each, and a whole environment by Monte-Carlo. The ports of
//! `render/{direct,monte_carlo}.rs` and of what they ask of the CPU engine.

mod monte_carlo;
mod points;
mod shadows;
mod tree;

pub use monte_carlo::{EnvironmentBuffers, Samples};
pub use tree::TreeBuffers;

use crate::gpu::Buffer;
use crate::gpu::raster::BlendEnd;

/// Memory that frames use one after the other.
#[derive(Debug, Default)]
pub struct RayMemory {
    /// Camera depth of each pixel's surface.
    depths: Option<Buffer<f32>>,
    /// Two groups a Gaussian: what it sends of one light.
    rows: Option<Buffer<[f32; 4]>>,
    /// The same of each pixel, planar.
    reflected: Option<Buffer<[f32; 4]>>,
    ends: Option<Buffer<BlendEnd>>,
    /// Diffuse and specular part of what each pixel sends, planar, times coverage.
    sent: Option<Buffer<[f32; 4]>>,
}
