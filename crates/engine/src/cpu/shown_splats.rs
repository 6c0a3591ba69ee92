//! The splats of a view, and the blending of values that are known for each of them.

use std::ops::Range;

use crate::RasterCamera;
use crate::cpu::blend::{BlendScratch, TileJob, blend_tile};
use crate::cpu::lanes::LANES;
use crate::cpu::project::Splat;
use crate::cpu::tiles::TileLists;
use crate::cpu::{AttributeSource, attribute_rows, project_all};
use relume_layout::channel::Channels;
use relume_layout::constants::{EarlyStop, TILE};

/// The splats of a view with their materials.
pub(super) struct ShownSplats {
    pub(super) view: RasterCamera,
    pub(super) splats: Vec<Splat>,
    tiles: TileLists,
    /// Splats that reach a tile.
    pub(super) shown: Vec<u32>,
    /// Attributes of the shown splats, rows of [`Self::MATERIAL`] floats.
    pub(super) materials: Vec<f32>,
}

/// Values of each splat, e.g. RGB per column of a light matrix.
pub struct ShadedColumns {
    pub(super) channels: usize,
    /// Floats per splat.
    pub(super) stored: usize,
    pub(super) attributes: Vec<f32>,
}

impl ShownSplats {
    /// Floats per row of materials.
    pub(super) const MATERIAL: usize = Channels::Material.stored();

    /// Projects the Gaussians of `source`, with their materials.
    pub(super) fn new(source: &AttributeSource<'_>, view: RasterCamera) -> Self {
        let projected = Self::without_materials(source, view);
        let of_shown: Vec<Splat> = projected.shown.iter().map(|i| projected.splats[*i as usize]).collect();
        let materials = attribute_rows(source, &view, &of_shown, Channels::Material, Self::MATERIAL);
        Self { materials, ..projected }
    }

    /// Projects the Gaussians of `source`.
    pub(super) fn without_materials(source: &AttributeSource<'_>, view: RasterCamera) -> Self {
        let splats = project_all(source, &view);
        let tiles = TileLists::new(view.width, view.height, &splats);
        let shown: Vec<u32> =
            (0..splats.len()).filter(|i| !tiles.slots_of_splat(*i).is_empty()).map(|i| i as u32).collect();
        Self { view, splats, tiles, shown, materials: Vec::new() }
    }

    /// The rows of the shown splats in `attributes`, which has a row of `stored` floats for each splat.
    pub(super) fn rows_of_shown<'a>(&self, attributes: &'a mut [f32], stored: usize) -> Vec<&'a mut [f32]> {
        let mut rows = Vec::with_capacity(self.shown.len());
        let mut shown = self.shown.iter().peekable();
        for (index, row) in attributes.chunks_exact_mut(stored.max(1)).enumerate() {
            if shown.next_if(|next| **next as usize == index).is_some() {
                rows.push(row);
            }
        }
        rows
    }

    /// Number of strips of a frame: runs of 16 rows.
    pub(super) fn strips(&self) -> usize {
        self.tiles.rows
    }

    /// Number of rows of strip `index`.
    pub(super) fn strip_rows(&self, index: usize) -> usize {
        TILE.min(self.view.height - index * TILE)
    }

    /// Strip `index` of the blended values, as `[channel][row][column of pixels]`.
    pub(super) fn strip(&self, shaded: &ShadedColumns, index: usize) -> Vec<f32> {
        let (width, rows) = (self.view.width, self.strip_rows(index));
        let mut out = vec![0.0f32; shaded.channels * rows * width];
        let (mut scratch, mut tile_out) = (BlendScratch::default(), vec![0.0; TILE * shaded.stored * LANES]);
        let tiles: Range<usize> = index * self.tiles.columns..(index + 1) * self.tiles.columns;
        for tile in tiles {
            let members = self.tiles.members(tile);
            if members.is_empty() {
                continue;
            }
            let origin = self.tiles.origin(tile);
            let job = TileJob {
                splats: &self.splats,
                members,
                attributes: &shaded.attributes,
                stored: shaded.stored,
                origin,
                early_stop: EarlyStop::WhenSaturated,
            };
            blend_tile(&job, &mut scratch, &mut tile_out);
            let across = LANES.min(width - origin.0);
            for row in 0..rows {
                for channel in 0..shaded.channels {
                    let from = &tile_out[(row * shaded.stored + channel) * LANES..][..across];
                    out[(channel * rows + row) * width + origin.0..][..across].copy_from_slice(from);
                }
            }
        }
        out
    }
}
