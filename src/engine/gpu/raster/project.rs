//! From parameters to splats and the lists of those each tile shows.

use crate::engine::DeviceError;
use crate::engine::gpu::grow::grow;
use crate::engine::gpu::raster::memory::Raster;
use crate::engine::gpu::raster::records::{SplatRecord, Words};
use crate::engine::gpu::raster::tiles::TileLists;
use crate::engine::gpu::{AttributeSource, Buffer, CameraUniform, Groups, Recorder, TILE, shaders, uniform};

/// What a view shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RasterCounts {
    /// Gaussians that pass the tests of the projection, on screen or not.
    pub visible: usize,
    /// (splat, tile) pairs.
    pub instances: usize,
}

/// A view whose splats and tile lists are known.
#[derive(Debug)]
pub struct Projected<'r> {
    pub(super) raster: &'r mut Raster,
    pub(in crate::engine::gpu) camera: CameraUniform,
    pub(in crate::engine::gpu) source: AttributeSource,
    /// By Gaussian.
    pub(in crate::engine::gpu) splats: Buffer<SplatRecord>,
    pub(super) tiles: TileLists,
    pub(super) counts: RasterCounts,
}

impl Projected<'_> {
    /// What the view shows.
    pub fn counts(&self) -> RasterCounts {
        self.counts
    }

    /// Gaussians of the model.
    pub(super) fn gaussians(&self) -> usize {
        self.source.layout.n as usize
    }

    /// (splat, pixel) pairs of all tiles.
    pub(super) fn pairs(&self) -> u64 {
        self.counts.instances as u64 * u64::from(TILE * TILE)
    }
}

impl Raster {
    /// Projects the Gaussians of `source` and lists the splats of each tile. Submits its work and waits for the counts: how
    /// many (splat, tile) pairs a view has decides how much memory its lists need. No other step waits.
    ///
    /// # Errors
    /// [`DeviceError::TooLarge`] with the numbers when the view has more (splat, tile) pairs than one binding holds;
    /// otherwise as [`Gpu::buffer`](crate::engine::gpu::Gpu::buffer) and [`Gpu::read`](crate::engine::gpu::Gpu::read).
    pub fn prepare(
        &mut self,
        camera: &CameraUniform,
        source: &AttributeSource,
    ) -> Result<Projected<'_>, DeviceError> {
        let gpu = self.gpu.clone();
        let mut rec = gpu.record();
        let (splats, gaussian_of_rank) = self.project(&mut rec, camera, source)?;
        rec.submit()?;
        let counted = gpu.read(&self.counts, 0..3)?;
        let pairs = u64::from(counted[2]) << 32 | u64::from(counted[1]);
        self.check_instances(pairs)?;
        let counts = RasterCounts { visible: counted[0] as usize, instances: pairs as usize };
        let mut rec = gpu.record();
        let n = source.layout.n as usize;
        let tiles = self.list(&mut rec, camera, &splats, &gaussian_of_rank, (n, counts.instances))?;
        rec.submit()?;
        let (camera, source) = (*camera, source.clone());
        Ok(Projected { raster: self, camera, source, splats, tiles, counts })
    }

    /// Records projection, depth order and the first instance of each rank; gives the splats, and the
    /// Gaussians nearest first, invisible ones last.
    pub(super) fn project(
        &mut self,
        rec: &mut Recorder<'_>,
        camera: &CameraUniform,
        source: &AttributeSource,
    ) -> Result<(Buffer<SplatRecord>, Buffer<u32>), DeviceError> {
        let (gpu, n) = (&self.gpu, source.layout.n as usize);
        let splats = grow(gpu, "splats", &mut self.splats, n)?;
        let keys = grow(gpu, "depth keys", &mut self.depth_keys, n)?;
        let gaussians = grow(gpu, "Gaussian indices", &mut self.gaussians, n)?;
        let n_tiles = grow(gpu, "tiles by rank", &mut self.n_tiles_of_rank, n)?;
        let first = grow(gpu, "first instances", &mut self.first_instance, n + 1)?;
        rec.stage("project");
        rec.clear(&self.counts);
        let bindings = [
            uniform(camera),
            uniform(&source.layout),
            (&source.params).into(),
            (&splats).into(),
            (&keys).into(),
            (&gaussians).into(),
            (&self.counts).into(),
        ];
        rec.dispatch(&shaders::PROJECT, Groups::Linear(n), &bindings);
        rec.stage("sort");
        let sorted = self.depth_sorter.sort(rec, &keys, &gaussians, n, u32::BITS)?.values;
        let size = Words([n as u32, 0, 0, 0]);
        let bindings = [uniform(&size), (&splats).into(), (&sorted).into(), (&n_tiles).into()];
        rec.dispatch(&shaders::TILE_COUNT, Groups::Linear(n), &bindings);
        self.scan.exclusive(rec, &n_tiles, &first, n)?;
        Ok((splats, sorted))
    }
}
