//! A truncated signed distance field on a grid over the unit ball (Curless and Levoy 1996).

use glam::Vec3;
use rayon::prelude::*;

use crate::render::mesh::views::DepthView;

/// Half of the side of the grid: the unit ball and a margin.
const HALF: f32 = 1.05;
/// Truncation distance, cells.
const TRUNCATION: f32 = 4.0;

/// Signed distances at the nodes of a grid, positive outside.
pub(super) struct DistanceField {
    cells: usize,
    /// Sums of the truncated distances, in truncation distances, and their numbers; x fastest, then y.
    nodes: Vec<(f32, f32)>,
}

impl DistanceField {
    pub(super) fn new(cells: usize) -> Self {
        Self { cells, nodes: vec![(0.0, 0.0); (cells + 1).pow(3)] }
    }

    /// Cells along an edge.
    pub(super) fn cells(&self) -> usize {
        self.cells
    }

    /// Side of a cell, world units.
    pub(super) fn cell(&self) -> f32 {
        2.0 * HALF / self.cells as f32
    }

    /// Position of a node, or of a point between nodes, world units.
    pub(super) fn place(&self, node: Vec3) -> Vec3 {
        node * self.cell() - HALF
    }

    /// Mean distance at a node in truncation distances; `None` without a view.
    pub(super) fn at(&self, [x, y, z]: [usize; 3]) -> Option<f32> {
        let n = self.cells + 1;
        let (sum, count) = self.nodes[(z * n + y) * n + x];
        (count > 0.0).then(|| sum / count)
    }

    /// Adds a view: nodes in front of its surface are outside, nodes slightly behind it inside.
    pub(super) fn add(&mut self, view: &DepthView) {
        let (n, truncation) = (self.cells + 1, TRUNCATION * self.cell());
        let (cell, half) = (self.cell(), Vec3::splat(HALF));
        self.nodes.par_chunks_mut(n * n).enumerate().for_each(|(z, slab)| {
            for (i, node) in slab.iter_mut().enumerate() {
                let point = Vec3::new((i % n) as f32, (i / n) as f32, z as f32) * cell - half;
                let Some(seen) = view.find(point) else { continue };
                let distance = (seen.depth - seen.z) / truncation;
                if distance > -1.0 {
                    node.0 += distance.min(1.0);
                    node.1 += 1.0;
                }
            }
        });
    }

    #[cfg(test)]
    pub(super) fn of(cells: usize, distance: impl Fn(Vec3) -> Option<f32>) -> Self {
        let mut out = Self::new(cells);
        let n = cells + 1;
        for i in 0..n.pow(3) {
            let point = out.place(Vec3::new((i % n) as f32, (i / n % n) as f32, (i / n / n) as f32));
            if let Some(d) = distance(point) {
                out.nodes[i] = (d, 1.0);
            }
        }
        out
    }
}
