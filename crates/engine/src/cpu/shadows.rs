//! Transmittance towards one direction from every Gaussian, by the footprints of all Gaussians on the plane perpendicular to
//! it.
//!
//! A square grid lists the footprints of each cell, nearest first. Up to sixteen queries of a cell, one per lane, visit its footprints
//! together in this order.

use multiversion::multiversion;

use crate::ProbeSettings;
use crate::cpu::lanes::{LANES, Lanes, exp_negative};
use crate::cpu::occluder::{Footprint, Occluder, Vec3, dot, plane_basis};
use relume_layout::constants::{ALPHA_MAX, MIN_TRANSMITTANCE, NO_HIT};

/// Mean number of Gaussians per cell of the grid.
const PER_CELL: usize = 16;
/// Number of footprints between two tests of whether all light is blocked.
const VISITED_BETWEEN_CHECKS: usize = 16;
/// Maximum number of cells along a side.
const MAX_GRID_SIDE: usize = 256;

/// Start point of the visibility measurement of a Gaussian.
#[derive(Debug, Clone, Copy)]
pub(super) struct VisibilityQuery {
    /// The Gaussian, which does not shadow itself.
    pub(super) gaussian: u32,
    pub(super) point: Vec3,
    /// Smallest distance of an occluder along the direction, world units.
    pub(super) clearance: f32,
}

/// A query projected to the plane perpendicular to one direction.
#[derive(Debug, Clone, Copy)]
struct PlaneQuery {
    gaussian: u32,
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

/// Up to sixteen queries of a cell, one per lane.
#[derive(Debug, Clone, Copy)]
struct QueryLanes {
    gaussian: [u32; LANES],
    place: [Lanes; 2],
    /// Infinite in an unused lane, so that no footprint is behind it.
    depth: Lanes,
    clearance: Lanes,
    /// The smallest and the largest depth of the queries.
    depths: (f32, f32),
}

/// Transmittance and dominant occluder of each lane.
struct Answers {
    transmittance: Lanes,
    hit: [u32; LANES],
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
        .map(|q| PlaneQuery {
            gaussian: q.gaussian,
            place: [dot(q.point, u), dot(q.point, v)],
            depth: dot(q.point, d),
            clearance: q.clearance,
        })
        .collect();
    let queries_of = grid.list(&projected, |a| grid.cells_under(a.place, [0.0; 2]));
    let (mut transmittance, mut hit) = (vec![1.0f32; queries.len()], vec![NO_HIT; queries.len()]);
    for cell in 0..grid.side * grid.side {
        let (of_cell, footprints) = (queries_of.of(cell), footprints.of(cell));
        if footprints.is_empty() {
            continue;
        }
        for together in of_cell.chunks(LANES) {
            let answers = answer(&flats, footprints, &QueryLanes::of(&projected, together), settings);
            for (lane, q) in together.iter().enumerate() {
                (transmittance[*q as usize], hit[*q as usize]) =
                    (answers.transmittance.0[lane], answers.hit[lane]);
            }
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

impl QueryLanes {
    fn of(projected: &[PlaneQuery], together: &[u32]) -> Self {
        let mut lanes = Self {
            gaussian: [NO_HIT; LANES],
            place: [Lanes::ZERO; 2],
            depth: Lanes([f32::INFINITY; LANES]),
            clearance: Lanes::ZERO,
            depths: (f32::INFINITY, f32::NEG_INFINITY),
        };
        for (lane, q) in together.iter().enumerate().take(LANES) {
            let q = &projected[*q as usize];
            lanes.gaussian[lane] = q.gaussian;
            (0..2).for_each(|k| lanes.place[k].0[lane] = q.place[k]);
            (lanes.depth.0[lane], lanes.clearance.0[lane]) = (q.depth, q.clearance);
            lanes.depths = (lanes.depths.0.min(q.depth), lanes.depths.1.max(q.depth));
        }
        lanes
    }

    /// Whether every query has less than [`MIN_TRANSMITTANCE`].
    #[inline(always)]
    fn are_dark(&self, transmittance: &Lanes) -> bool {
        let left = Lanes::from_fn(|i| if self.depth.0[i] < f32::INFINITY { transmittance.0[i] } else { 0.0 });
        left.max() < MIN_TRANSMITTANCE
    }

    /// Alpha of `f` at each query; 0 where it does not count ([`Footprint::alpha`]).
    #[inline(always)]
    fn alpha(&self, f: &ProjectedFootprint, settings: ProbeSettings) -> Lanes {
        let [a, b, c] = f.footprint.conic;
        let clearance = settings.clearance * f.footprint.thickness;
        Lanes::from_fn(|i| {
            let (dx, dy) = (self.place[0].0[i] - f.centre[0], self.place[1].0[i] - f.centre[1]);
            let power = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy;
            let away = f.depth - self.depth.0[i];
            // NaN fails every test.
            let counts = (f.depth > self.depth.0[i])
                & (away <= settings.reach)
                & (away >= clearance + self.clearance.0[i])
                & (power <= f.footprint.reach)
                & (f.index != self.gaussian[i]);
            let power = if power > 0.0 { power } else { 0.0 };
            let alpha = f.footprint.opacity * exp_negative(-power);
            let alpha = if alpha < ALPHA_MAX { alpha } else { ALPHA_MAX };
            if counts { alpha } else { 0.0 }
        })
    }
}

/// Transmittance and dominant occluder of queries, from the footprints `members` of their cell.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
fn answer(
    flats: &[ProjectedFootprint],
    members: &[u32],
    queries: &QueryLanes,
    settings: ProbeSettings,
) -> Answers {
    let (mut transmittance, mut strongest, mut hit) = (Lanes::ONE, Lanes::ZERO, [NO_HIT; LANES]);
    let (nearest, farthest) = queries.depths;
    let start = members.partition_point(|m| flats[*m as usize].depth <= nearest);
    for (visited, member) in members[start..].iter().enumerate() {
        let f = &flats[*member as usize];
        if f.depth - farthest > settings.reach {
            break;
        }
        let alpha = queries.alpha(f, settings);
        for i in 0..LANES {
            let weight = transmittance.0[i] * alpha.0[i];
            let is_stronger = weight > strongest.0[i];
            strongest.0[i] = if is_stronger { weight } else { strongest.0[i] };
            hit[i] = if is_stronger { f.index } else { hit[i] };
            transmittance.0[i] *= 1.0 - alpha.0[i];
        }
        // Every further footprint weighs less than `MIN_TRANSMITTANCE`; the first counted one weighed 1/255 or more.
        if visited % VISITED_BETWEEN_CHECKS == VISITED_BETWEEN_CHECKS - 1 && queries.are_dark(&transmittance)
        {
            break;
        }
    }
    let transmittance =
        Lanes::from_fn(|i| if transmittance.0[i] < MIN_TRANSMITTANCE { 0.0 } else { transmittance.0[i] });
    Answers { transmittance, hit }
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
