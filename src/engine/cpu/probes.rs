//! Transmittance probes: what each Gaussian sees of the sky, and which Gaussian hides the rest (docs/MODEL.md section 6).
//!
//! For one direction, all Gaussians are projected orthographically along it and listed by cell of a plane grid, far ones
//! last; a query then walks its cell outwards from its own depth. Directions are independent and run in parallel.

use rayon::prelude::*;

use crate::engine::cpu::attributes::AttributeSource;
use crate::engine::cpu::occluder::{
    Footprint, OPAQUE, Occluder, ProbeSettings, Vec3, dot, occluders, plane_basis,
};
use crate::engine::cpu::project::rotation;
use crate::light::sh_eval;
use crate::scene::{Field, sh_count};

/// No Gaussian hides the direction.
pub const NO_HIT: u32 = u32::MAX;

/// `n` directions spread evenly over the sphere (Fibonacci spiral).
pub fn fibonacci_sphere(n: usize) -> Vec<Vec3> {
    let golden = std::f64::consts::PI * (1.0 + 5.0f64.sqrt());
    (0..n)
        .map(|i| {
            let z = 1.0 - 2.0 * (i as f64 + 0.5) / n as f64;
            let r = (1.0 - z * z).max(0.0).sqrt();
            let phi = golden * (i as f64 + 0.5);
            [(r * phi.cos()) as f32, (r * phi.sin()) as f32, z as f32]
        })
        .collect()
}

/// Where a Gaussian asks from.
#[derive(Debug, Clone, Copy)]
struct Query {
    point: Vec3,
    /// Occluders must be this much further along.
    clearance: f32,
}

/// A Gaussian seen along one direction.
#[derive(Debug, Clone, Copy)]
struct Flat {
    index: u32,
    centre: [f32; 2],
    depth: f32,
    extent: [f32; 2],
    footprint: Footprint,
}

/// Measured visibility of a set of Gaussians.
#[derive(Debug, Clone)]
pub struct Probes {
    /// Unit directions.
    pub directions: Vec<Vec3>,
    /// `[direction][Gaussian]`: transmittance towards the direction.
    pub transmittance: Vec<Vec<f32>>,
    /// `[direction][Gaussian]`: the Gaussian that takes most of the rest, or [`NO_HIT`].
    pub hit: Vec<Vec<u32>>,
}

/// Unit normal of each Gaussian on its open side: the shortest axis, signed so that visibility is larger there.
pub fn outward_normals(source: &AttributeSource<'_>) -> Vec<Vec3> {
    let g = source.gaussians;
    (0..g.len())
        .into_par_iter()
        .with_min_len(256)
        .map(|i| {
            let s: Vec3 = g.get(Field::LogScale, i);
            let axis = if s[0] <= s[1] && s[0] <= s[2] {
                0
            } else if s[1] <= s[2] {
                1
            } else {
                2
            };
            let q = rotation(g.get(Field::Quaternion, i));
            let n: Vec3 = std::array::from_fn(|r| q[r][axis]);
            // The degree-1 part of the field points to the open side: Y_1 = k (-y, z, -x).
            let c = g.row(Field::Visibility, i);
            let open = if c.len() >= 4 { [-c[3], -c[1], c[2]] } else { [0.0; 3] };
            if dot(open, n) < 0.0 { n.map(|v| -v) } else { n }
        })
        .collect()
}

impl Probes {
    /// Measures `directions` from every Gaussian of `source`.
    ///
    /// Each from its centre, moved outwards as `settings` say.
    pub fn measure(source: &AttributeSource<'_>, directions: Vec<Vec3>, settings: ProbeSettings) -> Self {
        let occluders = occluders(source);
        let normals = outward_normals(source);
        let queries: Vec<Query> = occluders
            .iter()
            .zip(&normals)
            .map(|(o, n)| {
                let sigma = o.axes.iter().map(|a| dot(*a, *n).powi(2)).sum::<f32>().sqrt();
                let point =
                    std::array::from_fn(|k| o.mean[k] + (settings.offset * sigma + settings.lift) * n[k]);
                Query { point, clearance: sigma + settings.bias }
            })
            .collect();
        let measured: Vec<(Vec<f32>, Vec<u32>)> =
            directions.par_iter().map(|d| measure_direction(&occluders, &queries, *d, settings)).collect();
        let (transmittance, hit) = measured.into_iter().unzip();
        Self { directions, transmittance, hit }
    }

    /// Visibility coefficients of degree `order`, `[Gaussian][coefficient]`: `4 pi / D sum_d V Y`.
    pub fn coefficients(&self, order: usize) -> Vec<f32> {
        let n = sh_count(order);
        let weight = 4.0 * std::f32::consts::PI / self.directions.len().max(1) as f32;
        let basis: Vec<[f32; 64]> = self
            .directions
            .iter()
            .map(|d| {
                let mut y = [0.0f32; 64];
                sh_eval(order, *d, &mut y);
                y
            })
            .collect();
        let count = self.transmittance.first().map_or(0, Vec::len);
        let mut out = vec![0.0f32; count * n];
        out.par_chunks_mut(n).enumerate().with_min_len(256).for_each(|(i, c)| {
            for (t, y) in self.transmittance.iter().zip(&basis) {
                let v = weight * t[i];
                c.iter_mut().zip(y).for_each(|(c, y)| *c += v * y);
            }
        });
        out
    }
}

fn flatten(o: &Occluder, index: u32, d: Vec3, u: Vec3, v: Vec3) -> Option<Flat> {
    if !o.hides() {
        return None;
    }
    let footprint = o.along(d, u, v)?;
    let (centre, depth) = ([dot(o.mean, u), dot(o.mean, v)], dot(o.mean, d));
    Some(Flat { index, centre, depth, extent: footprint.extent(), footprint })
}

/// Cells of a square grid over the plane, each listing what overlaps it in order of depth.
struct Cells {
    origin: [f32; 2],
    inverse_size: [f32; 2],
    side: usize,
    first: Vec<u32>,
    members: Vec<u32>,
}

impl Cells {
    fn new(flats: &[Flat]) -> Self {
        let mut lo = [f32::INFINITY; 2];
        let mut hi = [f32::NEG_INFINITY; 2];
        for f in flats {
            for k in 0..2 {
                lo[k] = lo[k].min(f.centre[k]);
                hi[k] = hi[k].max(f.centre[k]);
            }
        }
        let side = ((flats.len() as f32).sqrt() as usize).clamp(1, 256);
        let inverse_size = std::array::from_fn(|k| side as f32 / (hi[k] - lo[k]).max(1e-20));
        let mut cells =
            Self { origin: lo, inverse_size, side, first: vec![0; side * side + 1], members: Vec::new() };
        for f in flats {
            cells.for_each_cell(f, |first, cell| first[cell + 1] += 1);
        }
        for i in 1..cells.first.len() {
            cells.first[i] += cells.first[i - 1];
        }
        let mut next = cells.first.clone();
        let mut members = vec![0u32; cells.first.last().copied().unwrap_or(0) as usize];
        for (i, f) in flats.iter().enumerate() {
            cells.for_each_cell(f, |_, cell| {
                members[next[cell] as usize] = i as u32;
                next[cell] += 1;
            });
        }
        cells.members = members;
        cells
    }

    fn coordinate(&self, k: usize, x: f32) -> usize {
        ((x - self.origin[k]) * self.inverse_size[k]).clamp(0.0, (self.side - 1) as f32) as usize
    }

    fn for_each_cell(&mut self, f: &Flat, mut visit: impl FnMut(&mut [u32], usize)) {
        let [x, y] = [0, 1].map(|k| {
            (self.coordinate(k, f.centre[k] - f.extent[k]), self.coordinate(k, f.centre[k] + f.extent[k]))
        });
        for row in y.0..=y.1 {
            for column in x.0..=x.1 {
                visit(&mut self.first, row * self.side + column);
            }
        }
    }

    fn at(&self, p: [f32; 2]) -> &[u32] {
        let cell = self.coordinate(1, p[1]) * self.side + self.coordinate(0, p[0]);
        &self.members[self.first[cell] as usize..self.first[cell + 1] as usize]
    }
}

/// Transmittance and dominant occluder of every query towards `d`.
fn measure_direction(
    occluders: &[Occluder],
    queries: &[Query],
    d: Vec3,
    settings: ProbeSettings,
) -> (Vec<f32>, Vec<u32>) {
    let (u, v) = plane_basis(d);
    let mut flats: Vec<Flat> =
        occluders.iter().enumerate().filter_map(|(i, o)| flatten(o, i as u32, d, u, v)).collect();
    flats.sort_unstable_by(|a, b| a.depth.total_cmp(&b.depth).then(a.index.cmp(&b.index)));
    let cells = Cells::new(&flats);
    let answer = |(i, q): (usize, &Query)| {
        let p = [dot(q.point, u), dot(q.point, v)];
        let depth = dot(q.point, d);
        let members = cells.at(p);
        let start = members.partition_point(|m| flats[*m as usize].depth <= depth);
        let (mut transmittance, mut strongest, mut hit) = (1.0f32, 0.0f32, NO_HIT);
        for m in &members[start..] {
            let f = &flats[*m as usize];
            if f.depth - depth > settings.reach {
                break;
            }
            if f.index as usize == i
                || f.depth - depth < settings.clearance * f.footprint.thickness + q.clearance
            {
                continue;
            }
            let Some(alpha) = f.footprint.alpha([p[0] - f.centre[0], p[1] - f.centre[1]]) else { continue };
            let weight = transmittance * alpha;
            if weight > strongest {
                (strongest, hit) = (weight, f.index);
            }
            transmittance *= 1.0 - alpha;
            if transmittance < OPAQUE {
                transmittance = 0.0;
                break;
            }
        }
        (transmittance, hit)
    };
    queries.iter().enumerate().map(answer).unzip()
}
