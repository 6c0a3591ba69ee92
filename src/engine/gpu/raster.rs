//! Rasterisation on the device: projection, depth order, tile lists, blending and the way back to the splats.
//!
//! [`Raster::prepare`] is the only step that waits for the device: how many (splat, tile) pairs a view has decides how
//! much memory its lists need. Everything else is recorded. All memory is kept from view to view and only grows.

use bytemuck::{Pod, Zeroable};

use crate::engine::channel::Channels;
use crate::engine::gpu::model::LayoutUniform;
use crate::engine::gpu::scan::{Scan, grow};
use crate::engine::gpu::shaders::Shader;
use crate::engine::gpu::sort::Sorter;
use crate::engine::gpu::{
    Buffer, CameraUniform, Gpu, GpuError, Groups, Recorder, SplatRecord, TILE, shaders, uniform,
};

mod backward;
mod light;
#[cfg(test)]
mod tests;

/// A pixel whose transmittance is below this is left early (as [`crate::engine::constants::TRANSMITTANCE_STOP`]).
const EARLY_STOP: f32 = crate::engine::constants::TRANSMITTANCE_STOP;
/// Where blending ends without early stop: what lies behind adds less than the last digit of anything, and
/// transmittances can still be recovered by division.
const LATE_STOP: f32 = 1e-30;
pub use crate::engine::gpu::kernel_constants::GRADIENT_HEADER;

/// Four words of a dispatch: counts, flags or bits of floats, as each shader names them.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(super) struct Words([u32; 4]);

/// How many vec4 of attributes a pass over `channels` carries.
pub fn groups(channels: Channels) -> usize {
    channels.stored() / 4
}

/// What a view shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RasterCounts {
    /// Gaussians that pass the tests of the projection, on screen or not.
    pub visible: usize,
    /// (splat, tile) pairs.
    pub instances: usize,
}

/// `BlendEnd` of `shared/alpha.wgsl`: where a pixel's blending ended.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct BlendEnd {
    /// Transmittance behind the last splat that counted.
    pub transmittance: f32,
    /// The slot after that splat's.
    pub slot: u32,
}

/// The view that was prepared last.
#[derive(Debug, Clone)]
pub(super) struct Prepared {
    pub(super) view: CameraUniform,
    pub(super) model: LayoutUniform,
    /// Gaussians by depth, nearest first; invisible ones last.
    pub(super) gaussian_of_rank: Buffer<u32>,
    /// The splats of each tile, tile by tile, nearest first.
    pub(super) gaussian_of_slot: Buffer<u32>,
    pub(super) first_slot: Buffer<u32>,
    pub(super) counts: RasterCounts,
}

impl Prepared {
    /// (splat, pixel) pairs of all tiles.
    pub(super) fn pairs(&self) -> u64 {
        self.counts.instances as u64 * u64::from(TILE * TILE)
    }
}

/// Buffers of the rasteriser. The public ones are `None` before the step that fills them.
#[derive(Debug)]
pub struct Raster {
    pub(super) gpu: Gpu,
    pub(super) prepared: Option<Prepared>,
    /// Splats by Gaussian ([`Raster::prepare`]).
    pub splats: Option<Buffer<SplatRecord>>,
    /// Attribute rows by Gaussian, `4 groups` floats each, undefined where a splat reaches no tile
    /// ([`Raster::attributes`]). A caller with attributes of its own puts its buffer here before
    /// blending.
    pub attributes: Option<Buffer<[f32; 4]>>,
    /// `[group][pixel]` ([`Raster::blend`]).
    pub gbuffer: Option<Buffer<[f32; 4]>>,
    /// By pixel ([`Raster::blend`]).
    pub ends: Option<Buffer<BlendEnd>>,
    /// Rows of [`GRADIENT_HEADER`]` + 4 groups` floats by Gaussian ([`Raster::blend_backward`]).
    pub splat_gradients: Option<Buffer<f32>>,
    /// `sum w That, sum w` by Gaussian ([`Raster::backward_labels`]).
    pub labels: Option<Buffer<[f32; 2]>>,
    /// Groups of channels blended from these attributes, 0 before.
    pub(super) blended_groups: usize,
    /// A short buffer for bindings without data.
    pub(super) nothing: Buffer<f32>,
    counts: Buffer<u32>,
    depth_keys: Option<Buffer<u32>>,
    gaussians: Option<Buffer<u32>>,
    n_tiles_of_rank: Option<Buffer<u32>>,
    first_instance: Option<Buffer<u32>>,
    tile_of_instance: Option<Buffer<u32>>,
    gaussian_of_instance: Option<Buffer<u32>>,
    first_slot: Option<Buffer<u32>>,
    depth_sorter: Sorter,
    tile_sorter: Sorter,
    scan: Scan,
}

impl Raster {
    /// A rasteriser without memory yet.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            gpu: gpu.clone(),
            prepared: None,
            splats: None,
            attributes: None,
            gbuffer: None,
            ends: None,
            splat_gradients: None,
            labels: None,
            blended_groups: 0,
            nothing: gpu.buffer("nothing", 4)?,
            counts: gpu.buffer("raster counts", 4)?,
            depth_keys: None,
            gaussians: None,
            n_tiles_of_rank: None,
            first_instance: None,
            tile_of_instance: None,
            gaussian_of_instance: None,
            first_slot: None,
            depth_sorter: Sorter::default(),
            tile_sorter: Sorter::default(),
            scan: Scan::default(),
        })
    }

    /// Projects the Gaussians in `params` and lists the splats of each tile. Submits its work and waits for the counts.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] with the numbers when the view has more (splat, tile) pairs than one binding holds;
    /// otherwise as [`Gpu::buffer`] and [`Gpu::read`].
    pub fn prepare(
        &mut self,
        view: &CameraUniform,
        model: &LayoutUniform,
        params: &Buffer<f32>,
    ) -> Result<RasterCounts, GpuError> {
        self.prepared = None;
        self.blended_groups = 0;
        let gpu = self.gpu.clone();
        let mut rec = gpu.record();
        let gaussian_of_rank = self.project(&mut rec, view, model, params)?;
        rec.submit()?;
        let counted = gpu.read(&self.counts, 0..3)?;
        let pairs = u64::from(counted[2]) << 32 | u64::from(counted[1]);
        self.check_instances(pairs)?;
        let counts = RasterCounts { visible: counted[0] as usize, instances: pairs as usize };
        let mut rec = gpu.record();
        let lists = self.list(&mut rec, view, &gaussian_of_rank, (model.n as usize, counts.instances))?;
        rec.submit()?;
        let (gaussian_of_slot, first_slot) = lists;
        let (view, model) = (*view, *model);
        self.prepared =
            Some(Prepared { view, model, gaussian_of_rank, gaussian_of_slot, first_slot, counts });
        Ok(counts)
    }

    /// Gaussians by depth, nearest first, invisible ones last; of the prepared view.
    pub fn gaussian_of_rank(&self) -> Option<&Buffer<u32>> {
        self.prepared.as_ref().map(|p| &p.gaussian_of_rank)
    }

    /// Blends the attributes into [`Self::gbuffer`]; `early_stop` leaves saturated pixels.
    ///
    /// # Errors
    /// [`GpuError::Internal`] without prepared view or attributes, or as [`Gpu::buffer`].
    pub fn blend(
        &mut self,
        rec: &mut Recorder<'_>,
        channels: Channels,
        early_stop: bool,
    ) -> Result<(), GpuError> {
        rec.stage("blend");
        let p = self.prepared()?;
        let groups = groups(channels);
        let shader = blend_shader(groups)?;
        let gbuffer = grow(&self.gpu, "the G-buffer", &mut self.gbuffer, groups * p.view.pixels())?;
        let ends = grow(&self.gpu, "blend ends", &mut self.ends, p.view.pixels())?;
        let splats = available(&self.splats, "splats")?;
        let attributes = available(&self.attributes, "attributes")?;
        if attributes.len() < p.model.n as usize * groups {
            return Err(GpuError::Internal("the attributes have fewer channels than are blended".into()));
        }
        let least = if early_stop { EARLY_STOP } else { LATE_STOP };
        let bindings = [
            uniform(&p.view),
            uniform(&Words([least.to_bits(), 0, 0, 0])),
            splats.into(),
            attributes.into(),
            (&p.gaussian_of_slot).into(),
            (&p.first_slot).into(),
            (&gbuffer).into(),
            (&ends).into(),
        ];
        rec.dispatch(shader, Groups::Grid(p.view.tiles[0], p.view.tiles[1]), &bindings);
        // Footprints and rows once a tile, sums once a pixel; an exponent and 4 groups of multiply-adds a pair.
        let row = 64 + 16 * groups as u64;
        let bytes = p.counts.instances as u64 * row + p.view.pixels() as u64 * (16 * groups as u64 + 8);
        rec.work(bytes, p.pairs() * (14 + 8 * groups as u64));
        self.blended_groups = groups;
        Ok(())
    }

    /// The prepared view.
    pub(super) fn prepared(&self) -> Result<Prepared, GpuError> {
        self.prepared.clone().ok_or_else(|| GpuError::Internal("no view has been prepared".into()))
    }

    /// Records projection, depth order and the first instance of each rank; gives the depth order.
    fn project(
        &mut self,
        rec: &mut Recorder<'_>,
        view: &CameraUniform,
        model: &LayoutUniform,
        params: &Buffer<f32>,
    ) -> Result<Buffer<u32>, GpuError> {
        let (gpu, n) = (&self.gpu, model.n as usize);
        let splats = grow(gpu, "splats", &mut self.splats, n)?;
        let keys = grow(gpu, "depth keys", &mut self.depth_keys, n)?;
        let gaussians = grow(gpu, "Gaussian indices", &mut self.gaussians, n)?;
        let n_tiles = grow(gpu, "tiles by rank", &mut self.n_tiles_of_rank, n)?;
        let first = grow(gpu, "first instances", &mut self.first_instance, n + 1)?;
        rec.stage("project");
        rec.clear(&self.counts);
        let bindings = [
            uniform(view),
            uniform(model),
            params.into(),
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
        Ok(sorted)
    }

    /// Records the tile lists: Gaussians by slot, and the first slot of each tile.
    fn list(
        &mut self,
        rec: &mut Recorder<'_>,
        view: &CameraUniform,
        gaussian_of_rank: &Buffer<u32>,
        (n, n_instances): (usize, usize),
    ) -> Result<(Buffer<u32>, Buffer<u32>), GpuError> {
        let n_tiles = view.tile_count();
        let tiles = grow(&self.gpu, "tile instances", &mut self.tile_of_instance, n_instances)?;
        let gaussians = grow(&self.gpu, "tile instances", &mut self.gaussian_of_instance, n_instances)?;
        let first_slot = grow(&self.gpu, "first slots", &mut self.first_slot, n_tiles + 1)?;
        let splats = available(&self.splats, "splats")?;
        let first_instance = available(&self.first_instance, "first instances")?;
        rec.stage("sort");
        let bindings = [
            uniform(view),
            uniform(&Words([n as u32, n_instances as u32, 0, 0])),
            splats.into(),
            gaussian_of_rank.into(),
            first_instance.into(),
            (&tiles).into(),
            (&gaussians).into(),
        ];
        rec.dispatch(&shaders::TILE_EMIT, Groups::Linear(n), &bindings);
        // Keys go from 0 to n_tiles: the latter marks instances that were counted and not found.
        let bits = (usize::BITS - n_tiles.leading_zeros()).max(1);
        let sorted = self.tile_sorter.sort(rec, &tiles, &gaussians, n_instances, bits)?;
        let size = Words([n_tiles as u32, n_instances as u32, 0, 0]);
        let bindings = [uniform(&size), (&sorted.keys).into(), (&first_slot).into()];
        rec.dispatch(&shaders::TILE_OFFSETS, Groups::Linear(n_tiles + 1), &bindings);
        Ok((sorted.values, first_slot))
    }

    fn check_instances(&self, pairs: u64) -> Result<(), GpuError> {
        let most = self.gpu.report().max_binding.min(self.gpu.report().max_buffer);
        // Indices are 32 bits wide, with room for a workgroup beyond the end.
        if pairs > (most / 4).min(u64::from(u32::MAX) - 4096) {
            let what = format!("the tile lists of a view with {pairs} pairs of splat and tile");
            return Err(GpuError::TooLarge { what, needs: pairs.saturating_mul(4), most });
        }
        Ok(())
    }
}

/// The buffer, or an error that says which step is missing.
pub(super) fn available<'b, T>(buffer: &'b Option<Buffer<T>>, what: &str) -> Result<&'b Buffer<T>, GpuError> {
    buffer.as_ref().ok_or_else(|| GpuError::Internal(format!("there are no {what} yet")))
}

fn blend_shader(groups: usize) -> Result<&'static Shader, GpuError> {
    Ok(match groups {
        1 => &shaders::BLEND_1,
        2 => &shaders::BLEND_2,
        4 => &shaders::BLEND_4,
        6 => &shaders::BLEND_6,
        8 => &shaders::BLEND_8,
        9 => &shaders::BLEND_9,
        12 => &shaders::BLEND_12,
        14 => &shaders::BLEND_14,
        18 => &shaders::BLEND_18,
        _ => return Err(no_kernel(groups)),
    })
}

/// No permutation was compiled for this many groups of channels.
pub(super) fn no_kernel(groups: usize) -> GpuError {
    GpuError::Internal(format!("no kernel for {groups} groups of channels"))
}
