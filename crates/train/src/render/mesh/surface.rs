//! The zero level set of a distance field as quads (naive surface nets, Gibson 1998): a vertex in each cell that the
//! surface crosses, and a quad around each grid edge that it crosses.

use std::collections::HashMap;

use glam::Vec3;

use crate::render::mesh::field::DistanceField;

/// Least share of all quads of a connected piece; smaller pieces are floaters and left out.
const MIN_PIECE_SHARE: f64 = 0.01;

/// Quads with shared vertices, world units.
pub(super) struct QuadMesh {
    pub(super) vertices: Vec<Vec3>,
    /// Corners counter-clockwise seen from outside.
    pub(super) quads: Vec<[u32; 4]>,
}

/// The surface of `field`, in cells whose corners are all known.
pub(super) fn of(field: &DistanceField) -> QuadMesh {
    let mut cells = HashMap::new();
    let mut out = QuadMesh { vertices: Vec::new(), quads: Vec::new() };
    let n = field.cells();
    let every = || (0..n).flat_map(|z| (0..n).flat_map(move |y| (0..n).map(move |x| [x, y, z])));
    for cell in every() {
        if let Some(vertex) = crossing(field, cell) {
            cells.insert(cell, out.vertices.len() as u32);
            out.vertices.push(field.place(vertex));
        }
    }
    for node in every() {
        for axis in 0..3 {
            out.quads.extend(quad(field, &cells, node, axis));
        }
    }
    out.quads = large_pieces(&out);
    out
}

/// Mean of the points at which the surface crosses the edges of a cell, in cells.
fn crossing(field: &DistanceField, cell: [usize; 3]) -> Option<Vec3> {
    let corner = |k: usize| [cell[0] + (k & 1), cell[1] + (k >> 1 & 1), cell[2] + (k >> 2)];
    let mut values = [0.0f32; 8];
    for (k, value) in values.iter_mut().enumerate() {
        *value = field.at(corner(k))?;
    }
    let (mut sum, mut count) = (Vec3::ZERO, 0.0);
    let place = |k: usize| Vec3::from(corner(k).map(|c| c as f32));
    for a in 0..8 {
        for b in [a | 1, a | 2, a | 4].into_iter().filter(|b| *b != a) {
            if (values[a] < 0.0) != (values[b] < 0.0) {
                sum += place(a).lerp(place(b), values[a] / (values[a] - values[b]));
                count += 1.0;
            }
        }
    }
    (count > 0.0).then(|| sum / count)
}

/// The quad around the edge from `node` along `axis`, if the surface crosses it and its four cells have vertices.
fn quad(
    field: &DistanceField,
    cells: &HashMap<[usize; 3], u32>,
    node: [usize; 3],
    axis: usize,
) -> Option<[u32; 4]> {
    let mut next = node;
    next[axis] += 1;
    let (here, there) = (field.at(node)?, field.at(next)?);
    if (here < 0.0) == (there < 0.0) {
        return None;
    }
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let beside = |back_u: usize, back_v: usize| {
        let mut cell = node;
        cell[u] = cell[u].checked_sub(back_u)?;
        cell[v] = cell[v].checked_sub(back_v)?;
        cells.get(&cell).copied()
    };
    let around = [beside(1, 1)?, beside(0, 1)?, beside(0, 0)?, beside(1, 0)?];
    // The outside is in the direction of increasing distance.
    Some(if here < 0.0 { around } else { [around[3], around[2], around[1], around[0]] })
}

/// The quads of all pieces that are not too small.
fn large_pieces(surface: &QuadMesh) -> Vec<[u32; 4]> {
    let mut parent: Vec<u32> = (0..surface.vertices.len() as u32).collect();
    for quad in &surface.quads {
        let first = root(&mut parent, quad[0]);
        for corner in &quad[1..] {
            let other = root(&mut parent, *corner);
            parent[other as usize] = first;
        }
    }
    let mut sizes: HashMap<u32, usize> = HashMap::new();
    for quad in &surface.quads {
        *sizes.entry(root(&mut parent, quad[0])).or_default() += 1;
    }
    let least = MIN_PIECE_SHARE * surface.quads.len() as f64;
    let is_large = |quad: &&[u32; 4]| sizes[&root(&mut parent, quad[0])] as f64 >= least;
    surface.quads.iter().filter(is_large).copied().collect()
}

/// The representative vertex of the piece of `v`.
fn root(parent: &mut [u32], mut v: u32) -> u32 {
    while parent[v as usize] != v {
        parent[v as usize] = parent[parent[v as usize] as usize];
        v = parent[v as usize];
    }
    v
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ball_surface_is_round_closed_and_faces_outwards() {
        let surface = of(&DistanceField::of(32, |p| Some(p.length() - 0.6)));
        let corner = |quad: &[u32; 4], k: usize| surface.vertices[quad[k] as usize];
        for quad in &surface.quads {
            for k in 0..4 {
                assert!((corner(quad, k).length() - 0.6).abs() < 0.02);
            }
            let normal = (corner(quad, 2) - corner(quad, 0)).cross(corner(quad, 3) - corner(quad, 1));
            assert!(normal.dot(corner(quad, 0)) > 0.0, "outwards");
        }
        // Euler: V - E + F = 2, and a closed surface of quads has E = 2 F.
        assert_eq!(surface.vertices.len(), surface.quads.len() + 2);
    }

    #[test]
    fn unseen_regions_and_small_specks_have_no_surface() {
        let open = |p: Vec3| (p.z > -0.3).then(|| p.length() - 0.6);
        let half = of(&DistanceField::of(32, open));
        assert!(half.vertices.iter().all(|v| v.z > -0.31));
        let speck = |p: Vec3| Some((p.length() - 0.6).min((p - Vec3::splat(0.8)).length() - 0.055));
        let field = DistanceField::of(48, speck);
        let is_speck =
            |surface: &QuadMesh, quad: &[u32; 4]| surface.vertices[quad[0] as usize].length() > 0.9;
        let surface = of(&field);
        assert!(surface.vertices.iter().any(|v| v.length() > 0.9), "the control: the field has one");
        assert!(!surface.quads.iter().any(|q| is_speck(&surface, q)));
    }
}
