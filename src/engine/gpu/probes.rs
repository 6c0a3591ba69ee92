//! Transmittance probes on the device: the port of [`crate::engine::cpu::Probes`] (docs/MODEL.md section 6).
//!
//! Directions are swept one after the other: flatten, sort by depth, list by cell, walk. How long the lists are is
//! learned for all directions together, by flattening them once beforehand, so that a measurement has one read-back
//! and not one a direction; where the longest list would take more memory than allowed, the grid is made
//! coarser, which changes no result, until it fits: with a single cell no list is longer than the model.

use bytemuck::{Pod, Zeroable};

use crate::engine::ProbeSettings;
use crate::engine::gpu::model::LayoutUniform;
use crate::engine::gpu::scan::{Scan, grow};
use crate::engine::gpu::sort::Sorter;
use crate::engine::gpu::{Buffer, Gpu, GpuError, Groups, Recorder, shaders, uniform};
use crate::light::sh_eval;
use crate::scene::{Field, sh_count};

#[cfg(test)]
pub(super) mod tests;

/// Most cells along an edge of the grid: a flat Gaussian keeps its first and last cell in a byte each.
const MOST_SIDE: usize = 256;
/// List entries a Gaussian that a direction may have on average before the grid is made coarser. On a software device
/// 3 entries a Gaussian (100,000 of them) took two thirds of the time of 6 and half of that of 16: sorting entries costs
/// more than walking the longer lists of larger cells.
const ENTRIES_A_GAUSSIAN: usize = 4;
/// List entries that any model may have.
const ENTRIES: usize = 1 << 18;
/// Directions handed over before the host waits for them: the host's patience is for a few, not for all of them.
const DIRECTIONS_AHEAD: usize = 16;
/// Floats of a direction's harmonics in the basis buffer, zeros included.
const BASIS: usize = 64;
/// Directions measured besides: the axes, for the bounding box.
const AXES: usize = 3;

/// `Sweep` of `shared/probe.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct Sweep {
    n: u32,
    n_directions: u32,
    direction_ix: u32,
    side: u32,
    n_instances: u32,
    clearance: f32,
    reach: f32,
    pad: u32,
}

/// `ProbeStart` of `probe_prepare.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct ProbeStart {
    offset: f32,
    lift: f32,
    bias: f32,
    pad: u32,
}

/// `Projection` of `probe_coefficients.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct Projection {
    n: u32,
    n_directions: u32,
    n_coefficients: u32,
    weight: f32,
}

/// `TileCounts` of `tile_offsets.wgsl`; the tiles are cells here.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct CellCounts {
    n_cells: u32,
    n_instances: u32,
    pad_a: u32,
    pad_b: u32,
}

/// `Frame` of `shared/probe.wgsl`: u, v and the direction.
type Frame = [[f32; 4]; 3];
/// `Occluder` of `shared/probe.wgsl`.
type Occluder = [f32; 16];
/// `Flat` of `shared/probe.wgsl`.
type Flat = [u32; 12];

/// Measured visibility of a model, in device memory.
#[derive(Debug, Clone)]
pub struct ProbeBuffers {
    /// Gaussians measured.
    pub n: usize,
    /// Coefficients a Gaussian has.
    pub n_coefficients: usize,
    /// Unit directions.
    pub directions: Buffer<[f32; 4]>,
    /// Unit normals by Gaussian on the open side, as of the visibility field before the measurement.
    pub normals: Buffer<[f32; 4]>,
    /// `[direction][Gaussian]`: transmittance towards the direction, 0..=1.
    pub transmittance: Buffer<f32>,
    /// `[direction][Gaussian]`: the Gaussian that takes most of the rest, or [`NO_HIT`](crate::engine::constants::NO_HIT).
    pub hit: Buffer<u32>,
    /// `[Gaussian][coefficient]`: `4 pi / D sum_d V Y`.
    pub coefficients: Buffer<f32>,
}

impl ProbeBuffers {
    fn empty(gpu: &Gpu, n: usize, directions: &[[f32; 3]], n_coefficients: usize) -> Result<Self, GpuError> {
        let n_directions = directions.len();
        let by_direction = |what: &str| format!("{what} of {n_directions} directions from {n} Gaussians");
        let flat_directions: Vec<[f32; 4]> = directions.iter().map(|d| padded(*d)).collect();
        Ok(Self {
            n,
            n_coefficients,
            transmittance: gpu.buffer(&by_direction("transmittances"), n * n_directions)?,
            hit: gpu.buffer(&by_direction("hits"), n * n_directions)?,
            directions: gpu.upload("probe directions", &flat_directions)?,
            normals: gpu.buffer("outward normals", n)?,
            coefficients: gpu.buffer("visibility coefficients", n * n_coefficients)?,
        })
    }

    /// Replaces the visibility field of the planar `params` by the measured coefficients (the field lies in memory as
    /// they do).
    ///
    /// # Errors
    /// [`GpuError::Internal`] when the model has another shape.
    pub fn store(
        &self,
        rec: &mut Recorder<'_>,
        params: &Buffer<f32>,
        model: &LayoutUniform,
    ) -> Result<(), GpuError> {
        let (first, len) = (model.start(Field::Visibility), self.n * self.n_coefficients);
        if (model.n as usize, model.n_visibility as usize) != (self.n, self.n_coefficients)
            || params.len() < first + len
        {
            return Err(GpuError::Internal("probes of another model".to_owned()));
        }
        rec.copy(&self.coefficients, 0, params, first, len);
        Ok(())
    }
}

/// Namespace of the measurement, as [`crate::engine::cpu::Probes`].
#[derive(Debug)]
pub struct Probes;

impl Probes {
    /// Measures `directions` (unit) from every Gaussian of the model in `params`, and their coefficients of degree
    /// `order`, at most 6. Waits for the device, but reads back only how long the lists are.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] with the numbers when transmittances by direction and Gaussian do not fit one binding,
    /// [`GpuError::Internal`] for a wrong order or a buffer that is too short, or as [`Gpu::buffer`].
    pub fn measure(
        gpu: &Gpu,
        params: &Buffer<f32>,
        model: &LayoutUniform,
        settings: ProbeSettings,
        directions: &[[f32; 3]],
        order: usize,
    ) -> Result<ProbeBuffers, GpuError> {
        let entries = ENTRIES.max(ENTRIES_A_GAUSSIAN * model.n as usize);
        let side = (model.n as f32).sqrt() as usize;
        let mut sweeper = Sweeper::new(gpu, model, settings, directions, order)?;
        sweeper.measure(params, model, side.clamp(1, MOST_SIDE), entries)
    }
}

/// One measurement and its memory.
struct Sweeper<'g> {
    gpu: &'g Gpu,
    sweep: Sweep,
    settings: ProbeSettings,
    out: ProbeBuffers,
    basis: Buffer<f32>,
    frames: Buffer<Frame>,
    bounds: Buffer<f32>,
    occluders: Buffer<Occluder>,
    queries: Buffer<[f32; 4]>,
    flats: Buffer<Flat>,
    depth_keys: Buffer<u32>,
    gaussians: Buffer<u32>,
    totals: Buffer<u32>,
    n_cells_of_rank: Buffer<u32>,
    first_instance: Buffer<u32>,
    cell_of_instance: Option<Buffer<u32>>,
    gaussian_of_instance: Option<Buffer<u32>>,
    first_slot: Option<Buffer<u32>>,
    sorter: Sorter,
    scan: Scan,
}

impl<'g> Sweeper<'g> {
    fn new(
        gpu: &'g Gpu,
        model: &LayoutUniform,
        settings: ProbeSettings,
        directions: &[[f32; 3]],
        order: usize,
    ) -> Result<Self, GpuError> {
        if order > 6 {
            return Err(GpuError::Internal(format!("probes of order {order}")));
        }
        let (n, n_directions) = (model.n as usize, directions.len());
        let out = ProbeBuffers::empty(gpu, n, directions, sh_count(order))?;
        let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let frames: Vec<Frame> = directions.iter().chain(&axes).map(|d| frame(*d)).collect();
        let mut basis = vec![0.0f32; n_directions * BASIS];
        basis.chunks_exact_mut(BASIS).zip(directions).for_each(|(y, d)| sh_eval(order, *d, y));
        let sweep = Sweep {
            n: model.n,
            n_directions: n_directions as u32,
            direction_ix: 0,
            side: 1,
            n_instances: 0,
            clearance: settings.clearance,
            // Shaders may assume that nothing is infinite.
            reach: settings.reach.min(f32::MAX),
            pad: 0,
        };
        Ok(Self {
            gpu,
            sweep,
            settings,
            out,
            basis: gpu.upload("probe basis", &basis)?,
            frames: gpu.upload("probe frames", &frames)?,
            bounds: gpu.upload("probe bounds", &[0.0; 8])?,
            occluders: gpu.buffer("occluders", n)?,
            queries: gpu.buffer("probe queries", n)?,
            flats: gpu.buffer("flat Gaussians", n)?,
            depth_keys: gpu.buffer("depth keys", n)?,
            gaussians: gpu.buffer("Gaussians by depth", n)?,
            totals: gpu.buffer("list lengths", 2 * (n_directions + AXES))?,
            n_cells_of_rank: gpu.buffer("cells by rank", n)?,
            first_instance: gpu.buffer("first list entries", n + 1)?,
            cell_of_instance: None,
            gaussian_of_instance: None,
            first_slot: None,
            sorter: Sorter::default(),
            scan: Scan::default(),
        })
    }

    fn measure(
        &mut self,
        params: &Buffer<f32>,
        model: &LayoutUniform,
        side: usize,
        entries: usize,
    ) -> Result<ProbeBuffers, GpuError> {
        self.prepare(params, model)?;
        let totals = self.fitting_grid(side, entries)?;
        for (direction_ix, total) in totals.into_iter().enumerate() {
            self.direction(direction_ix, total)?;
            if direction_ix % DIRECTIONS_AHEAD == DIRECTIONS_AHEAD - 1 {
                self.gpu.wait()?;
            }
        }
        let mut rec = self.gpu.record();
        self.coefficients(&mut rec);
        rec.submit()?;
        Ok(self.out.clone())
    }

    /// Occluders, queries and normals, and the box of the grids.
    fn prepare(&mut self, params: &Buffer<f32>, model: &LayoutUniform) -> Result<(), GpuError> {
        let s = self.settings;
        let start = ProbeStart { offset: s.offset, lift: s.lift, bias: s.bias, pad: 0 };
        let mut rec = self.gpu.record();
        rec.stage("probes");
        let bindings = [
            uniform(model),
            uniform(&start),
            params.into(),
            (&self.occluders).into(),
            (&self.queries).into(),
            (&self.out.normals).into(),
        ];
        rec.dispatch(&shaders::PROBE_PREPARE, Groups::Linear(self.out.n), &bindings);
        rec.clear(&self.totals);
        for axis in 0..AXES {
            self.sweep.direction_ix = self.sweep.n_directions + axis as u32;
            self.flatten(&mut rec);
            let sorted = self.by_depth(&mut rec)?;
            let bindings = [uniform(&self.sweep), (&sorted.keys).into(), (&self.bounds).into()];
            // What is sorted does not depend on the bounds that change here; only the unused cells do.
            rec.dispatch(&shaders::PROBE_BOUNDS, Groups::Workgroups(1), &bindings);
        }
        rec.submit()
    }

    /// Sets the finest grid, from `side` down, with which no direction lists more than `entries`; list lengths by
    /// direction.
    fn fitting_grid(&mut self, side: usize, entries: usize) -> Result<Vec<usize>, GpuError> {
        let report = self.gpu.report();
        // Sorting also counts 256 digits by block of 2048.
        let most = entries.max(self.out.n).min((report.max_binding.min(report.max_buffer) / 4) as usize);
        let n_directions = self.sweep.n_directions as usize;
        self.sweep.side = side as u32;
        loop {
            let mut rec = self.gpu.record();
            rec.stage("probes");
            rec.clear(&self.totals);
            for direction_ix in 0..n_directions {
                self.sweep.direction_ix = direction_ix as u32;
                self.flatten(&mut rec);
            }
            rec.submit()?;
            let words = self.gpu.read(&self.totals, 0..2 * n_directions)?;
            let totals =
                words.as_chunks::<2>().0.iter().map(|[lo, hi]| u64::from(*lo) | u64::from(*hi) << 32);
            if totals.clone().all(|t| t <= most as u64) || self.sweep.side == 1 {
                return Ok(totals.map(|t| t as usize).collect());
            }
            self.sweep.side /= 2;
        }
    }

    /// Flat Gaussians along the sweep's direction, and their depth keys.
    fn flatten(&self, rec: &mut Recorder<'_>) {
        let bindings = [
            uniform(&self.sweep),
            (&self.frames).into(),
            (&self.bounds).into(),
            (&self.occluders).into(),
            (&self.flats).into(),
            (&self.depth_keys).into(),
            (&self.gaussians).into(),
            (&self.totals).into(),
        ];
        rec.dispatch(&shaders::PROBE_FLATTEN, Groups::Linear(self.out.n), &bindings);
    }

    fn by_depth(&mut self, rec: &mut Recorder<'_>) -> Result<crate::engine::gpu::Pairs, GpuError> {
        self.sorter.sort(rec, &self.depth_keys, &self.gaussians, self.out.n, 32)
    }

    /// Measures one direction, whose lists have `n_instances` entries.
    fn direction(&mut self, direction_ix: usize, n_instances: usize) -> Result<(), GpuError> {
        let n = self.out.n;
        self.sweep.direction_ix = direction_ix as u32;
        self.sweep.n_instances = n_instances as u32;
        let mut rec = self.gpu.record();
        rec.stage("probes");
        self.flatten(&mut rec);
        let by_depth = self.by_depth(&mut rec)?;
        let sweep = self.sweep;
        let bindings = [
            uniform(&sweep),
            (&self.flats).into(),
            (&by_depth.values).into(),
            (&self.n_cells_of_rank).into(),
        ];
        rec.dispatch(&shaders::PROBE_COUNT, Groups::Linear(n), &bindings);
        self.scan.exclusive(&mut rec, &self.n_cells_of_rank, &self.first_instance, n)?;
        let cells = grow(self.gpu, "cells of list entries", &mut self.cell_of_instance, n_instances)?;
        let listed =
            grow(self.gpu, "Gaussians of list entries", &mut self.gaussian_of_instance, n_instances)?;
        let bindings = [
            uniform(&sweep),
            (&self.flats).into(),
            (&by_depth.values).into(),
            (&self.first_instance).into(),
            (&cells).into(),
            (&listed).into(),
        ];
        rec.dispatch(&shaders::PROBE_EMIT, Groups::Linear(n), &bindings);
        let n_cells = (sweep.side * sweep.side) as usize;
        let bits = (n_cells - 1).checked_ilog2().map_or(1, |b| b + 1);
        let sorted = self.sorter.sort(&mut rec, &cells, &listed, n_instances, bits)?;
        let first_slot = grow(self.gpu, "first slots of cells", &mut self.first_slot, n_cells + 1)?;
        let counts =
            CellCounts { n_cells: n_cells as u32, n_instances: sweep.n_instances, pad_a: 0, pad_b: 0 };
        let bindings = [uniform(&counts), (&sorted.keys).into(), (&first_slot).into()];
        rec.dispatch(&shaders::TILE_OFFSETS, Groups::Linear(n_cells + 1), &bindings);
        self.walk(&mut rec, &first_slot, &sorted.values);
        rec.submit()
    }

    fn walk(&self, rec: &mut Recorder<'_>, first_slot: &Buffer<u32>, gaussian_of_slot: &Buffer<u32>) {
        let bindings = [
            uniform(&self.sweep),
            (&self.frames).into(),
            (&self.bounds).into(),
            (&self.queries).into(),
            (&self.flats).into(),
            first_slot.into(),
            gaussian_of_slot.into(),
            (&self.out.transmittance).into(),
            (&self.out.hit).into(),
        ];
        rec.dispatch(&shaders::PROBE_WALK, Groups::Linear(self.out.n), &bindings);
    }

    fn coefficients(&self, rec: &mut Recorder<'_>) {
        rec.stage("probes");
        let n_directions = self.sweep.n_directions;
        let projection = Projection {
            n: self.sweep.n,
            n_directions,
            n_coefficients: self.out.n_coefficients as u32,
            weight: direction_weight(n_directions as usize),
        };
        let bindings = [
            uniform(&projection),
            (&self.basis).into(),
            (&self.out.transmittance).into(),
            (&self.out.coefficients).into(),
        ];
        let groups = self.out.n.div_ceil(256) * self.out.n_coefficients.div_ceil(16);
        rec.dispatch(&shaders::PROBE_COEFFICIENTS, Groups::Workgroups(groups), &bindings);
    }
}

/// Solid angle a direction stands for, sr.
pub(super) fn direction_weight(n_directions: usize) -> f32 {
    4.0 * std::f32::consts::PI / n_directions.max(1) as f32
}

fn padded([x, y, z]: [f32; 3]) -> [f32; 4] {
    [x, y, z, 0.0]
}

/// The direction and two vectors across it, the same as on the CPU.
fn frame(d: [f32; 3]) -> Frame {
    let (u, v) = glam::Vec3::from_array(d).any_orthonormal_pair();
    [padded(u.to_array()), padded(v.to_array()), padded(d)]
}
