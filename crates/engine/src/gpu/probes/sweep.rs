//! The loop of a measurement over its directions.
//!
//! Directions run one after the other: flatten, sort by depth, list per cell, walk. A first pass flattens all directions to
//! find the lengths of their lists, so that a measurement has one read-back instead of one per direction. Where the longest
//! list would take more memory than allowed, the grid is made coarser until it fits, which changes no result: with a single
//! cell no list is longer than the model.

use bytemuck::{Pod, Zeroable};

use crate::gpu::grow::grow;
use crate::gpu::model::LayoutUniform;
use crate::gpu::probes::buffers::{ProbeBuffers, direction_weight, padded};
use crate::gpu::scan::Scan;
use crate::gpu::sort::{Pairs, Sorter};
use crate::gpu::{Buffer, Gpu, Groups, InFlightLimit, Recorder, Submission, shaders, uniform};
use crate::{DeviceError, ProbeSettings};

/// Maximum number of cells along an edge of the grid: a flat Gaussian stores its first and last cell in a byte each.
const MAX_GRID_SIDE: usize = 256;
/// Mean number of list entries per Gaussian in a direction above which the grid is made coarser, on a software device. With
/// 100,000 Gaussians, 3 entries per Gaussian took two thirds of the time of 6 and half of that of 16: sorting entries costs
/// more than walking the longer lists of larger cells.
const ENTRIES_A_GAUSSIAN: usize = 4;
/// The same on other devices. On an H100 and 40,000 Gaussians of a room, 32 entries per Gaussian took half of the time of 4.
const ENTRIES_A_GAUSSIAN_ON_HARDWARE: usize = 32;
/// Number of list entries that every model may have.
const ENTRIES: usize = 1 << 18;
/// Number of directions flattened in one submission.
const FLATTENED_AT_ONCE: usize = 16;
/// Number of additional directions: the axes, for the bounding box.
const AXES: usize = 3;

/// `Sweep` of `shared/probe.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(super) struct Sweep {
    pub(super) n: u32,
    pub(super) n_directions: u32,
    pub(super) direction_ix: u32,
    pub(super) side: u32,
    pub(super) n_instances: u32,
    pub(super) clearance: f32,
    pub(super) reach: f32,
    pub(super) pad: u32,
}

/// `ProbeStart` of `probe_prepare.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(super) struct ProbeStart {
    pub(super) offset: f32,
    pub(super) lift: f32,
    pub(super) bias: f32,
    pub(super) pad: u32,
}

/// `Projection` of `probe_coefficients.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(super) struct Projection {
    pub(super) n: u32,
    pub(super) n_directions: u32,
    pub(super) n_coefficients: u32,
    pub(super) weight: f32,
}

/// `TileCounts` of `tile_offsets.wgsl`; the tiles are cells here.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(super) struct CellCounts {
    pub(super) n_cells: u32,
    pub(super) n_instances: u32,
    pub(super) pad_a: u32,
    pub(super) pad_b: u32,
}

/// `Frame` of `shared/probe.wgsl`: u, v and the direction.
pub(super) type Axes = [[f32; 4]; 3];
/// `Occluder` of `shared/probe.wgsl`.
pub(super) type Occluder = [f32; 16];
/// `Flat` of `shared/probe.wgsl`.
pub(super) type Flat = [u32; 12];

/// Measures `directions` (unit) from every Gaussian of the model in `params`, and their coefficients of degree `sh_degree`,
/// at most 6. Waits for the device slice by slice; reads only the lengths of the lists back.
///
/// # Errors
/// [`DeviceError::TooLarge`] with the numbers when transmittances by direction and Gaussian do not fit one binding,
/// [`DeviceError::Misuse`] for a wrong degree or a buffer that is too short, or as [`Gpu::buffer`].
pub fn measure(
    gpu: &Gpu,
    params: &Buffer<f32>,
    model: &LayoutUniform,
    settings: ProbeSettings,
    directions: &[[f32; 3]],
    sh_degree: usize,
) -> Result<ProbeBuffers, DeviceError> {
    let each = if gpu.report().software { ENTRIES_A_GAUSSIAN } else { ENTRIES_A_GAUSSIAN_ON_HARDWARE };
    let entries = ENTRIES.max(each * model.n as usize);
    let side = (model.n as f32).sqrt() as usize;
    let mut sweeper = Sweeper::new(gpu, model, settings, directions, sh_degree)?;
    sweeper.measure(params, model, side.clamp(1, MAX_GRID_SIDE), entries)
}

/// One measurement and its memory.
pub(super) struct Sweeper<'g> {
    pub(super) gpu: &'g Gpu,
    pub(super) sweep: Sweep,
    pub(super) settings: ProbeSettings,
    pub(super) out: ProbeBuffers,
    pub(super) frames: Buffer<Axes>,
    pub(super) bounds: Buffer<f32>,
    pub(super) occluders: Buffer<Occluder>,
    pub(super) queries: Buffer<[f32; 4]>,
    pub(super) flats: Buffer<Flat>,
    pub(super) depth_keys: Buffer<u32>,
    pub(super) gaussians: Buffer<u32>,
    pub(super) totals: Buffer<u32>,
    pub(super) n_cells_of_rank: Buffer<u32>,
    pub(super) first_instance: Buffer<u32>,
    pub(super) cell_of_instance: Option<Buffer<u32>>,
    pub(super) gaussian_of_instance: Option<Buffer<u32>>,
    pub(super) first_slot: Option<Buffer<u32>>,
    pub(super) pace: InFlightLimit,
    pub(super) sorter: Sorter,
    pub(super) scan: Scan,
}

impl<'g> Sweeper<'g> {
    pub(super) fn new(
        gpu: &'g Gpu,
        model: &LayoutUniform,
        settings: ProbeSettings,
        directions: &[[f32; 3]],
        sh_degree: usize,
    ) -> Result<Self, DeviceError> {
        if sh_degree > 6 {
            return Err(DeviceError::Misuse(format!("probes of order {sh_degree}")));
        }
        let (n, n_directions) = (model.n as usize, directions.len());
        let out = ProbeBuffers::empty(gpu, n, directions, sh_degree)?;
        let coordinates = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let frames: Vec<Axes> = directions.iter().chain(&coordinates).map(|d| axes(*d)).collect();
        let sweep = Sweep {
            n: model.n,
            n_directions: n_directions as u32,
            direction_ix: 0,
            side: 1,
            n_instances: 0,
            clearance: settings.clearance,
            // Shader compilers may assume that no value is infinite.
            reach: settings.reach.min(f32::MAX),
            pad: 0,
        };
        Ok(Self {
            gpu,
            sweep,
            settings,
            out,
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
            pace: InFlightLimit::default(),
            sorter: Sorter::default(),
            scan: Scan::default(),
        })
    }

    pub(super) fn measure(
        &mut self,
        params: &Buffer<f32>,
        model: &LayoutUniform,
        side: usize,
        entries: usize,
    ) -> Result<ProbeBuffers, DeviceError> {
        self.prepare(params, model)?;
        let totals = self.fitting_grid(side, entries)?;
        for (direction_ix, total) in totals.into_iter().enumerate() {
            let submission = self.direction(direction_ix, total)?;
            self.pace.follow(submission)?;
        }
        let mut rec = self.gpu.record();
        self.coefficients(&mut rec);
        self.pace.follow(rec.submit()?)?;
        self.pace.finish()?;
        Ok(self.out.clone())
    }

    /// Computes occluders, queries and normals, and the bounding box of the grids.
    fn prepare(&mut self, params: &Buffer<f32>, model: &LayoutUniform) -> Result<(), DeviceError> {
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
            // The sorted coordinates do not depend on the bounds that change here; only the unused cells do.
            rec.dispatch(&shaders::PROBE_BOUNDS, Groups::Workgroups(1), &bindings);
        }
        self.pace.follow(rec.submit()?)
    }

    /// Sets the finest grid, from `side` down, with which no direction lists more than `entries` entries; returns the list
    /// lengths per direction.
    fn fitting_grid(&mut self, side: usize, entries: usize) -> Result<Vec<usize>, DeviceError> {
        let report = self.gpu.report();
        // Sorting also counts 256 digits per block of 2048.
        let most = entries.max(self.out.n).min((report.max_binding.min(report.max_buffer) / 4) as usize);
        let n_directions = self.sweep.n_directions as usize;
        self.sweep.side = side as u32;
        loop {
            let mut rec = self.gpu.record();
            rec.clear(&self.totals);
            for direction_ix in 0..n_directions {
                if direction_ix > 0 && direction_ix.is_multiple_of(FLATTENED_AT_ONCE) {
                    self.pace.follow(std::mem::replace(&mut rec, self.gpu.record()).submit()?)?;
                }
                rec.stage("probes");
                self.sweep.direction_ix = direction_ix as u32;
                self.flatten(&mut rec);
            }
            let halves = rec.fetch(&self.totals, 0..2 * n_directions);
            let halves = rec.submit()?.wait_for_data()?.read(&halves)?;
            let totals =
                halves.as_chunks::<2>().0.iter().map(|[lo, hi]| u64::from(*lo) | u64::from(*hi) << 32);
            if totals.clone().all(|t| t <= most as u64) || self.sweep.side == 1 {
                return Ok(totals.map(|t| t as usize).collect());
            }
            self.sweep.side /= 2;
        }
    }

    /// Flattens the Gaussians along the current direction and computes their depth keys.
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

    fn by_depth(&mut self, rec: &mut Recorder<'_>) -> Result<Pairs, DeviceError> {
        self.sorter.sort(rec, &self.depth_keys, &self.gaussians, self.out.n, 32)
    }

    /// Measures one direction, whose lists have `n_instances` entries.
    fn direction(&mut self, direction_ix: usize, n_instances: usize) -> Result<Submission, DeviceError> {
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
        let unlimited = self.sorter.unlimited(self.gpu)?;
        let bindings = [uniform(&counts), (&sorted.keys).into(), (&unlimited).into(), (&first_slot).into()];
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
            (&self.out.basis).into(),
            (&self.out.transmittance).into(),
            (&self.out.coefficients).into(),
        ];
        let groups = self.out.n.div_ceil(256) * self.out.n_coefficients.div_ceil(16);
        rec.dispatch(&shaders::PROBE_COEFFICIENTS, Groups::Workgroups(groups), &bindings);
    }
}

/// The direction and two vectors perpendicular to it, the same as on the CPU.
fn axes(d: [f32; 3]) -> Axes {
    let (u, v) = glam::Vec3::from_array(d).any_orthonormal_pair();
    [padded(u.to_array()), padded(v.to_array()), padded(d)]
}
