//! Projection of parameters to splats, and the list of splats per tile.

use crate::DeviceError;
use crate::gpu::grow::grow;
use crate::gpu::raster::memory::Raster;
use crate::gpu::raster::records::{DispatchParams, LIST_STATUS_WORDS, RasterCounts, SplatRecord};
use crate::gpu::raster::tiles::TileLists;
use crate::gpu::{AttributeSource, Buffer, CameraUniform, Groups, Recorder, TILE, shaders, uniform};

/// A view with its splats and tile lists.
#[derive(Debug)]
pub struct Projected<'r> {
    pub(super) raster: &'r mut Raster,
    pub(in crate::gpu) camera: CameraUniform,
    pub(in crate::gpu) source: AttributeSource,
    /// The splat of each Gaussian.
    pub(in crate::gpu) splats: Buffer<SplatRecord>,
    pub(in crate::gpu) tiles: TileLists,
    pub(super) counts: RasterCounts,
}

impl Projected<'_> {
    /// Counts of the view or, while they are not known, of the previous one.
    pub fn counts(&self) -> RasterCounts {
        self.counts
    }

    /// Status of the tile lists, the input of [`Raster::apply_list_status`].
    pub fn list_status(&self) -> &Buffer<u32> {
        &self.raster.list_status
    }

    /// Number of Gaussians of the model.
    pub(super) fn gaussians(&self) -> usize {
        self.source.layout.n as usize
    }

    /// Number of (splat, pixel) pairs of all tiles.
    pub(super) fn pairs(&self) -> u64 {
        self.counts.instances as u64 * u64::from(TILE * TILE)
    }
}

impl Raster {
    /// Records projection and tile lists of a view of `source`, without waiting for the device. The host learns later whether
    /// the lists are complete ([`Self::apply_list_status`]); until then the counts are those of an earlier view.
    ///
    /// # Errors
    /// As [`Gpu::buffer`](crate::gpu::Gpu::buffer).
    pub fn record(
        &mut self,
        rec: &mut Recorder<'_>,
        camera: &CameraUniform,
        source: &AttributeSource,
    ) -> Result<Projected<'_>, DeviceError> {
        let (splats, gaussian_of_rank) = self.project(rec, camera, source)?;
        let n = source.layout.n as usize;
        let capacity = self.capacity_for(n);
        let tiles = match self.list(rec, camera, &splats, &gaussian_of_rank, (n, capacity)) {
            // The last view's lists may fit where larger ones do not.
            Err(DeviceError::TooLarge { .. } | DeviceError::OutOfMemory { .. }) if self.shrink_to_fit() => {
                self.list(rec, camera, &splats, &gaussian_of_rank, (n, self.capacity))?
            }
            list_status => list_status?,
        };
        let (camera, source, counts) = (*camera, source.clone(), self.last);
        Ok(Projected { raster: self, camera, source, splats, tiles, counts })
    }

    /// Projects and lists with complete lists and with counts of this view. Waits for the device.
    ///
    /// # Errors
    /// As [`Self::record`] and [`Self::apply_list_status`].
    pub fn prepare(
        &mut self,
        camera: &CameraUniform,
        source: &AttributeSource,
    ) -> Result<Projected<'_>, DeviceError> {
        let gpu = self.gpu.clone();
        loop {
            let mut rec = gpu.record();
            let Projected { splats, tiles, .. } = self.record(&mut rec, camera, source)?;
            let list_status = rec.fetch(&self.list_status, 0..LIST_STATUS_WORDS);
            let list_status = rec.submit()?.wait_for_data()?.read(&list_status)?;
            if self.apply_list_status(&list_status)? {
                let (camera, source, counts) = (*camera, source.clone(), self.last);
                return Ok(Projected { raster: self, camera, source, splats, tiles, counts });
            }
        }
    }

    /// Records projection, depth order and the first instance of each rank. Returns the splats, and the Gaussians sorted by
    /// depth, nearest first, invisible ones last.
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
        let size = DispatchParams([n as u32, 0, 0, 0]);
        let bindings = [uniform(&size), (&splats).into(), (&sorted).into(), (&n_tiles).into()];
        rec.dispatch(&shaders::TILE_COUNT, Groups::Linear(n), &bindings);
        self.scan.exclusive(rec, &n_tiles, &first, n)?;
        Ok((splats, sorted))
    }
}
