//! Cameras in the layout of the shaders.

use bytemuck::{Pod, Zeroable};

use crate::RasterCamera;
use crate::gpu::recorder::Groups;

/// Side of a tile, pixels.
pub const TILE: u32 = relume_layout::constants::TILE as u32;

/// `Camera` of `shaders/shared/camera.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct CameraUniform {
    /// Focal lengths, pixels.
    pub focal: [f32; 2],
    /// Principal point, pixels.
    pub centre_px: [f32; 2],
    /// Rows of the world-to-camera matrix: rotation, then translation.
    pub rotation: [[f32; 4]; 3],
    /// Camera centre, padded.
    pub centre: [f32; 4],
    /// Limits of x/z, then of y/z.
    pub ratio_limits: [f32; 4],
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Tile columns and rows.
    pub tiles: [u32; 2],
    /// Screen-space low-pass, px^2.
    pub low_pass: f32,
    /// 1 where the opacity compensates for the low-pass, else 0.
    pub low_pass_compensation: u32,
    /// Number of pixels of the image.
    pub n_pixels: u32,
    /// Unused.
    pub pad: u32,
}

impl CameraUniform {
    /// `view` in the layout of the shaders.
    pub fn new(view: &RasterCamera) -> Self {
        let padded = |v: [f32; 3]| [v[0], v[1], v[2], 0.0];
        let row = |k: usize| {
            let [x, y, z] = view.rotation[k];
            [x, y, z, view.translation[k]]
        };
        let [x, y] = view.ratio_limits;
        let size = [view.width as u32, view.height as u32];
        Self {
            focal: view.focal,
            centre_px: view.centre_px,
            rotation: std::array::from_fn(row),
            centre: padded(view.centre),
            ratio_limits: [x[0], x[1], y[0], y[1]],
            size,
            tiles: size.map(|s| s.div_ceil(TILE)),
            low_pass: view.low_pass,
            low_pass_compensation: u32::from(view.low_pass_compensation),
            n_pixels: size[0] * size[1],
            pad: 0,
        }
    }

    /// Number of pixels of the image.
    pub fn pixels(&self) -> usize {
        self.n_pixels as usize
    }

    /// One workgroup of 16 x 16 invocations per tile.
    pub(super) fn tile_groups(&self) -> Groups {
        Groups::Grid(self.tiles[0], self.tiles[1])
    }

    /// Number of tiles of the image.
    pub fn tile_count(&self) -> usize {
        self.tiles[0] as usize * self.tiles[1] as usize
    }
}
