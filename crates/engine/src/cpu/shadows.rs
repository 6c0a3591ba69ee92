//! Transmittance towards one direction from every Gaussian, by the footprints of all Gaussians on the plane perpendicular to
//! it.
//!
//! A square grid lists the footprints of each cell, nearest first. The queries of a cell are answered together: its
//! footprints are laid out once, sixteen in lanes, and each query visits them in order of depth, from its own depth on.

use multiversion::multiversion;

use crate::ProbeSettings;
use crate::cpu::lanes::{LANES, Lanes, exp_negative};
use crate::cpu::occluder::{Footprint, Occluder, Vec3, dot, plane_basis};
use relume_layout::constants::{ALPHA_MAX, MIN_TRANSMITTANCE, NO_HIT};

/// Mean number of Gaussians per cell of the grid.
const PER_CELL: usize = 4;
/// Maximum number of cells along a side.
const MAX_GRID_SIDE: usize = 256;

/// Start point of the visibility measurement of a Gaussian.
#[derive(Debug, Clone, Copy)]
pub(super) struct VisibilityQuery {
    pub(super) point: Vec3,
    /// Smallest distance of an occluder along the direction, world units.
    pub(super) clearance: f32,
}

/// A query projected to the plane perpendicular to one direction.
#[derive(Debug, Clone, Copy)]
struct PlaneQuery {
    index: u32,
    place: [f32; 2],
    depth: f32,
    clearance: f32,
}

/// The footprint of a Gaussian along one direction.
#[derive(Debug, Clone, Copy)]
struct ProjectedFootprint {
    index: u32,
    centre: [f32; 2],
    depth: f32,
    extent: [f32; 2],
    footprint: Footprint,
}

/// Sixteen footprints, one per lane, in order of depth; an unused lane is infinitely far and has no reach.
#[derive(Debug, Clone)]
struct Block {
    index: [u32; LANES],
    centre: [Lanes; 2],
    depth: Lanes,
    /// Smallest distance at which a footprint counts, in addition to the query's clearance.
    clearance: Lanes,
    conic: [Lanes; 3],
    opacity: Lanes,
    reach: Lanes,
}

/// Transmittance and dominant occluder of every query towards `d`.
pub(super) fn measure_direction(
    occluders: &[Occluder],
    queries: &[VisibilityQuery],
    d: Vec3,
    settings: ProbeSettings,
) -> (Vec<f32>, Vec<u32>) {
    let (u, v) = plane_basis(d);
    let flats =
        nearest_first(occluders.iter().enumerate().filter_map(|(i, o)| flatten(o, i as u32, d, u, v)));
    let grid = Grid::over(&flats);
    let footprints = grid.list(&flats, |f| grid.cells_under(f.centre, f.extent));
    let projected: Vec<PlaneQuery> = queries
        .iter()
        .enumerate()
        .map(|(i, q)| PlaneQuery {
            index: i as u32,
            place: [dot(q.point, u), dot(q.point, v)],
            depth: dot(q.point, d),
            clearance: q.clearance,
        })
        .collect();
    let queries_of = grid.list(&projected, |a| grid.cells_under(a.place, [0.0; 2]));
    let (mut transmittance, mut hit) = (vec![1.0f32; queries.len()], vec![NO_HIT; queries.len()]);
    let mut blocks = Vec::new();
    for cell in 0..grid.side * grid.side {
        if queries_of.of(cell).is_empty() || footprints.of(cell).is_empty() {
            continue;
        }
        lay_out(&flats, footprints.of(cell), settings.clearance, &mut blocks);
        for &q in queries_of.of(cell) {
            let projected = &projected[q as usize];
            (transmittance[projected.index as usize], hit[projected.index as usize]) =
                answer(&blocks, projected, settings.reach);
        }
    }
    (transmittance, hit)
}

/// Footprints sorted by depth, ties by index.
fn nearest_first(flats: impl Iterator<Item = ProjectedFootprint>) -> Vec<ProjectedFootprint> {
    let flats: Vec<ProjectedFootprint> = flats.collect();
    // The sort moves keys instead of footprints; their order is that of `f32::total_cmp`.
    let key = |depth: f32| {
        let bits = depth.to_bits();
        bits ^ if bits >> 31 == 1 { u32::MAX } else { 1 << 31 }
    };
    let mut keys: Vec<u64> =
        flats.iter().enumerate().map(|(i, f)| u64::from(key(f.depth)) << 32 | i as u64).collect();
    keys.sort_unstable();
    keys.iter().map(|key| flats[(key & 0xffff_ffff) as usize]).collect()
}

fn flatten(o: &Occluder, index: u32, d: Vec3, u: Vec3, v: Vec3) -> Option<ProjectedFootprint> {
    if !o.occludes() {
        return None;
    }
    let footprint = o.along(d, u, v)?;
    let (centre, depth) = ([dot(o.mean, u), dot(o.mean, v)], dot(o.mean, d));
    Some(ProjectedFootprint { index, centre, depth, extent: footprint.extent(), footprint })
}

/// The footprints of `members` as blocks.
fn lay_out(flats: &[ProjectedFootprint], members: &[u32], clearance: f32, blocks: &mut Vec<Block>) {
    blocks.clear();
    blocks.extend(members.chunks(LANES).map(|members| {
        let mut block = Block::nothing();
        for (lane, m) in members.iter().enumerate() {
            block.put(lane, &flats[*m as usize], clearance);
        }
        block
    }));
}

impl Block {
    fn nothing() -> Self {
        Self {
            index: [NO_HIT; LANES],
            centre: [Lanes::ZERO; 2],
            depth: Lanes([f32::INFINITY; LANES]),
            clearance: Lanes::ZERO,
            conic: [Lanes::ZERO; 3],
            opacity: Lanes::ZERO,
            reach: Lanes([f32::NEG_INFINITY; LANES]),
        }
    }

    fn put(&mut self, lane: usize, f: &ProjectedFootprint, clearance: f32) {
        self.index[lane] = f.index;
        (0..2).for_each(|k| self.centre[k].0[lane] = f.centre[k]);
        self.depth.0[lane] = f.depth;
        self.clearance.0[lane] = clearance * f.footprint.thickness;
        (0..3).for_each(|k| self.conic[k].0[lane] = f.footprint.conic[k]);
        self.opacity.0[lane] = f.footprint.opacity;
        self.reach.0[lane] = f.footprint.reach;
    }

    /// Exponent of each footprint at the query.
    #[inline(always)]
    fn power(&self, q: &PlaneQuery) -> Lanes {
        Lanes::from_fn(|i| {
            let (dx, dy) = (q.place[0] - self.centre[0].0[i], q.place[1] - self.centre[1].0[i]);
            let [a, b, c] = [0, 1, 2].map(|k| self.conic[k].0[i]);
            0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
        })
    }

    /// The footprints that count, one bit each ([`Footprint::alpha`]).
    #[inline(always)]
    fn counting(&self, q: &PlaneQuery, reach: f32, power: &Lanes) -> u32 {
        let mut bits = 0;
        for i in 0..LANES {
            let away = self.depth.0[i] - q.depth;
            // NaN fails every test.
            let counts = (self.depth.0[i] > q.depth)
                & (away <= reach)
                & (away >= self.clearance.0[i] + q.clearance)
                & (power.0[i] <= self.reach.0[i])
                & (self.index[i] != q.index);
            bits |= u32::from(counts) << i;
        }
        bits
    }

    /// Alpha of each footprint, including those that do not count.
    #[inline(always)]
    fn alpha(&self, power: &Lanes) -> Lanes {
        Lanes::from_fn(|i| {
            let power = if power.0[i] > 0.0 { power.0[i] } else { 0.0 };
            let alpha = self.opacity.0[i] * exp_negative(-power);
            if alpha < ALPHA_MAX { alpha } else { ALPHA_MAX }
        })
    }
}

/// Transmittance and dominant occluder of one query, from the footprints of its cell.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
fn answer(blocks: &[Block], q: &PlaneQuery, reach: f32) -> (f32, u32) {
    let (mut transmittance, mut strongest, mut hit) = (1.0f32, 0.0f32, NO_HIT);
    let start = blocks.partition_point(|b| b.depth.0[LANES - 1] <= q.depth);
    for block in &blocks[start..] {
        if block.depth.0[0] - q.depth > reach {
            break;
        }
        let power = block.power(q);
        let mut counting = block.counting(q, reach, &power);
        if counting == 0 {
            continue;
        }
        let alpha = block.alpha(&power);
        while counting != 0 {
            let lane = counting.trailing_zeros() as usize % LANES;
            counting &= counting - 1;
            let weight = transmittance * alpha.0[lane];
            if weight > strongest {
                (strongest, hit) = (weight, block.index[lane]);
            }
            transmittance *= 1.0 - alpha.0[lane];
        }
        // Every further footprint weighs less than `MIN_TRANSMITTANCE`; the first counted one weighed 1/255 or more.
        if transmittance < MIN_TRANSMITTANCE {
            return (0.0, hit);
        }
    }
    (transmittance, hit)
}

/// A square grid over the plane.
struct Grid {
    origin: [f32; 2],
    inverse_size: [f32; 2],
    side: usize,
}

/// Members of each cell of a [`Grid`], in the order given.
struct CellLists {
    first: Vec<u32>,
    members: Vec<u32>,
}

/// First and last column, first and last row.
type Span = [u16; 4];

impl Grid {
    /// A grid over the centres of `flats`.
    fn over(flats: &[ProjectedFootprint]) -> Self {
        let mut lo = [f32::INFINITY; 2];
        let mut hi = [f32::NEG_INFINITY; 2];
        for f in flats {
            for k in 0..2 {
                lo[k] = lo[k].min(f.centre[k]);
                hi[k] = hi[k].max(f.centre[k]);
            }
        }
        let side = ((flats.len() as f32 / PER_CELL as f32).sqrt() as usize).clamp(1, MAX_GRID_SIDE);
        let inverse_size = std::array::from_fn(|k| side as f32 / (hi[k] - lo[k]).max(1e-20));
        Self { origin: lo, inverse_size, side }
    }

    /// Index along axis `k`; coordinates beyond the grid map to its outermost cells.
    fn coordinate(&self, k: usize, x: f32) -> usize {
        ((x - self.origin[k]) * self.inverse_size[k]).clamp(0.0, (self.side - 1) as f32) as usize
    }

    fn cells_under(&self, centre: [f32; 2], extent: [f32; 2]) -> Span {
        let coordinate = |k: usize, x: f32| self.coordinate(k, x) as u16;
        let [left, top] = [0, 1].map(|k| coordinate(k, centre[k] - extent[k]));
        let [right, bottom] = [0, 1].map(|k| coordinate(k, centre[k] + extent[k]));
        [left, right, top, bottom]
    }

    fn list<T>(&self, things: &[T], span: impl Fn(&T) -> Span) -> CellLists {
        let mut first = vec![0u32; self.side * self.side + 1];
        let spans: Vec<Span> = things.iter().map(span).collect();
        // The cells of a row are contiguous.
        let rows = |span: &Span| {
            let [left, right, top, bottom] = span.map(usize::from);
            (top..=bottom).map(move |row| row * self.side + left..row * self.side + right + 1)
        };
        for span in &spans {
            rows(span)
                .for_each(|cells| first[cells.start + 1..cells.end + 1].iter_mut().for_each(|n| *n += 1));
        }
        for i in 1..first.len() {
            first[i] += first[i - 1];
        }
        let mut next = first.clone();
        let mut members = vec![0u32; first.last().copied().unwrap_or(0) as usize];
        for (i, span) in spans.iter().enumerate() {
            for cells in rows(span) {
                for next in &mut next[cells] {
                    members[*next as usize] = i as u32;
                    *next += 1;
                }
            }
        }
        CellLists { first, members }
    }
}

impl CellLists {
    fn of(&self, cell: usize) -> &[u32] {
        &self.members[self.first[cell] as usize..self.first[cell + 1] as usize]
    }
}
