//! Memory of the rasteriser.

use crate::DeviceError;
use crate::gpu::raster::records::{BlendEnd, LIST_STATUS_WORDS, OversizedViews, RasterCounts, SplatRecord};
use crate::gpu::scan::Scan;
use crate::gpu::sort::Sorter;
use crate::gpu::{Buffer, Gpu};

/// A rasteriser: memory that successive frames share.
#[derive(Debug)]
pub struct Raster {
    pub(super) gpu: Gpu,
    /// A short buffer for bindings without data.
    pub(super) nothing: Buffer<f32>,
    /// Visible Gaussians, then the low and the high half of the number of (splat, tile) pairs.
    pub(super) counts: Buffer<u32>,
    /// Status of the last view's tile lists, see `shaders/tile_capacity.wgsl`.
    pub(super) list_status: Buffer<u32>,
    /// Capacity of a view's lists, (splat, tile) pairs.
    pub(super) capacity: usize,
    pub(super) oversized: OversizedViews,
    /// Counts of the last view whose counts are known.
    pub(super) last: RasterCounts,
    pub(super) splats: Option<Buffer<SplatRecord>>,
    pub(super) depth_keys: Option<Buffer<u32>>,
    pub(super) gaussians: Option<Buffer<u32>>,
    pub(super) n_tiles_of_rank: Option<Buffer<u32>>,
    pub(super) first_instance: Option<Buffer<u32>>,
    pub(super) tile_of_instance: Option<Buffer<u32>>,
    pub(super) gaussian_of_instance: Option<Buffer<u32>>,
    pub(super) first_slot: Option<Buffer<u32>>,
    pub(super) attributes: Option<Buffer<[f32; 4]>>,
    pub(super) colours: Option<Buffer<[f32; 4]>>,
    pub(super) gbuffer: Option<Buffer<[f32; 4]>>,
    pub(super) ends: Option<Buffer<BlendEnd>>,
    pub(super) by_gbuffer: Option<Buffer<[f32; 4]>>,
    pub(super) splat_gradients: Option<Buffer<f32>>,
    pub(super) labels: Option<Buffer<[f32; 2]>>,
    pub(super) depth_sorter: Sorter,
    pub(super) tile_sorter: Sorter,
    pub(super) scan: Scan,
}

impl Raster {
    /// A rasteriser without allocated memory.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu) -> Result<Self, DeviceError> {
        Ok(Self {
            gpu: gpu.clone(),
            nothing: gpu.buffer("nothing", 4)?,
            counts: gpu.buffer("raster counts", 4)?,
            list_status: gpu.upload("status of the tile lists", &[0; LIST_STATUS_WORDS])?,
            capacity: 0,
            oversized: OversizedViews::default(),
            last: RasterCounts::default(),
            splats: None,
            depth_keys: None,
            gaussians: None,
            n_tiles_of_rank: None,
            first_instance: None,
            tile_of_instance: None,
            gaussian_of_instance: None,
            first_slot: None,
            attributes: None,
            colours: None,
            gbuffer: None,
            ends: None,
            by_gbuffer: None,
            splat_gradients: None,
            labels: None,
            depth_sorter: Sorter::default(),
            tile_sorter: Sorter::default(),
            scan: Scan::default(),
        })
    }
}
