//! Structs that the rasteriser's shaders read and write.

use bytemuck::{Pod, Zeroable};

/// Four numbers of a dispatch: counts, flags or bits of floats; each shader names them.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(super) struct DispatchParams(pub(super) [u32; 4]);

/// Elements of the buffer with the status of a view's tile lists (`shaders/tile_capacity.wgsl`).
pub(super) const LIST_STATUS_WORDS: usize = 5;

/// Counts of a view.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RasterCounts {
    /// Number of Gaussians that pass the tests of the projection, on screen or not.
    pub visible: usize,
    /// Number of (splat, tile) pairs.
    pub instances: usize,
}

/// Consecutive views with much more memory than they needed.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct OversizedViews {
    pub(super) count: u32,
    /// Number of pairs of the largest of them.
    pub(super) most: usize,
}

/// `Splat` of `shaders/shared/splat.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct SplatRecord {
    /// Projected mean, pixels.
    pub mean: [f32; 2],
    /// Opacity, compensation included.
    pub opacity: f32,
    /// `ln(255 opacity)`.
    pub reach: f32,
    /// Inverse of the screen covariance.
    pub conic: [f32; 3],
    /// Camera depth.
    pub depth: f32,
    /// Screen covariance, low-pass included.
    pub covariance: [f32; 3],
    /// Factor of the compensation.
    pub compensation: f32,
    /// Number of tiles that it reaches.
    pub n_tiles: u32,
    /// 1 when visible; otherwise no other member may be read.
    pub flags: u32,
    /// Unused.
    pub pad_a: u32,
    /// Unused.
    pub pad_b: u32,
}

/// `BlendEnd` of `shared/alpha.wgsl`: the end of a pixel's blending.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct BlendEnd {
    /// Transmittance behind the last splat that counted.
    pub transmittance: f32,
    /// The slot after that splat's.
    pub slot: u32,
}
