//! Lists of the splats of each tile.

use crate::DeviceError;
use crate::gpu::grow::grow;
use crate::gpu::raster::memory::Raster;
use crate::gpu::raster::records::{DispatchParams, SplatRecord};
use crate::gpu::sort::PairCount;
use crate::gpu::{Buffer, CameraUniform, Groups, Recorder, shaders, uniform};

/// The splats of each tile, tile by tile, nearest first.
#[derive(Debug, Clone)]
pub(in crate::gpu) struct TileLists {
    pub(in crate::gpu) gaussian_of_slot: Buffer<u32>,
    pub(in crate::gpu) first_slot: Buffer<u32>,
}

impl Raster {
    /// Records the lists of a view of `n` Gaussians, for at most `n_instances` (splat, tile) pairs, and then their status
    /// ([`Raster::apply_list_status`]).
    pub(super) fn list(
        &mut self,
        rec: &mut Recorder<'_>,
        camera: &CameraUniform,
        splats: &Buffer<SplatRecord>,
        gaussian_of_rank: &Buffer<u32>,
        (n, n_instances): (usize, usize),
    ) -> Result<TileLists, DeviceError> {
        let n_tiles = camera.tile_count();
        let tiles = grow(&self.gpu, "tile instances", &mut self.tile_of_instance, n_instances)?;
        let gaussians = grow(&self.gpu, "tile instances", &mut self.gaussian_of_instance, n_instances)?;
        let first_slot = grow(&self.gpu, "first slots", &mut self.first_slot, n_tiles + 1)?;
        let first_instance = grow(&self.gpu, "first instances", &mut self.first_instance, n + 1)?;
        rec.stage("sort");
        let capacity = DispatchParams([n_instances as u32, 0, 0, 0]);
        let bindings = [uniform(&capacity), (&self.counts).into(), (&self.list_status).into()];
        rec.dispatch(&shaders::TILE_CAPACITY, Groups::Workgroups(1), &bindings);
        let bindings = [
            uniform(camera),
            uniform(&DispatchParams([n as u32, n_instances as u32, 0, 0])),
            splats.into(),
            gaussian_of_rank.into(),
            (&first_instance).into(),
            (&tiles).into(),
            (&gaussians).into(),
        ];
        rec.dispatch(&shaders::TILE_EMIT, Groups::Linear(n), &bindings);
        // Keys range from 0 to n_tiles; n_tiles marks instances that were counted but not emitted.
        let bits = (usize::BITS - n_tiles.leading_zeros()).max(1);
        let list_status = PairCount { most: n_instances, counted: Some(&self.list_status) };
        let sorted = self.tile_sorter.sort(rec, &tiles, &gaussians, list_status, bits)?;
        let size = DispatchParams([n_tiles as u32, n_instances as u32, 0, 0]);
        let bindings =
            [uniform(&size), (&sorted.keys).into(), (&self.list_status).into(), (&first_slot).into()];
        rec.dispatch(&shaders::TILE_OFFSETS, Groups::Linear(n_tiles + 1), &bindings);
        Ok(TileLists { gaussian_of_slot: sorted.values, first_slot })
    }
}
