//! Lists of the splats that touch each tile, in depth order.

use rayon::prelude::*;

use crate::cpu::lanes::LANES;
use crate::cpu::project::Splat;
use relume_layout::constants::TILE;

/// Splats per task.
const CHUNK: usize = 1024;

// A strip is one tile row.
const _: () = assert!(TILE == LANES);

/// For each tile, the indices of the splats that reach a pixel of it, nearest first, ties by index.
///
/// `slot` is a position in `splat_of_slot`; a tile owns consecutive slots, a splat owns consecutive instances.
#[derive(Debug, Clone, Default)]
pub struct TileLists {
    /// Tiles across.
    pub columns: usize,
    /// Tiles down.
    pub rows: usize,
    /// First slot of each tile, and the end.
    pub first_slot: Vec<u32>,
    /// Splat in each slot, by depth inside a tile.
    pub splat_of_slot: Vec<u32>,
    /// First instance of each splat, and the end.
    pub first_instance: Vec<u32>,
    /// Slot of each instance.
    pub slot_of_instance: Vec<u32>,
}

impl TileLists {
    /// Bins splats over a `width` x `height` image.
    pub fn new(width: usize, height: usize, splats: &[Splat]) -> Self {
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        let found: Vec<(Vec<u32>, Vec<u32>)> =
            splats.par_chunks(CHUNK).map(|splats| tiles_of(splats, columns, rows)).collect();
        let tile_of_instance: Vec<u32> = found.iter().flat_map(|(tiles, _)| tiles).copied().collect();
        let mut first_instance = Vec::with_capacity(splats.len() + 1);
        let mut next = 0;
        for tiles_of_splat in found.iter().flat_map(|(_, counts)| counts) {
            first_instance.push(next);
            next += tiles_of_splat;
        }
        first_instance.push(next);
        let mut count = vec![0u32; columns * rows + 1];
        tile_of_instance.iter().for_each(|tile| count[*tile as usize + 1] += 1);
        for i in 1..count.len() {
            count[i] += count[i - 1];
        }
        let first_slot = count.clone();
        let mut splat_of_slot = vec![0u32; tile_of_instance.len()];
        let mut slot_of_instance = vec![0u32; tile_of_instance.len()];
        for splat in by_depth(splats) {
            for instance in first_instance[splat] as usize..first_instance[splat + 1] as usize {
                let next = &mut count[tile_of_instance[instance] as usize];
                splat_of_slot[*next as usize] = splat as u32;
                slot_of_instance[instance] = *next;
                *next += 1;
            }
        }
        Self { columns, rows, first_slot, splat_of_slot, first_instance, slot_of_instance }
    }

    /// Number of tiles.
    pub fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// True when the image has no pixel.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The slots of tile `tile`.
    pub fn slots(&self, tile: usize) -> std::ops::Range<usize> {
        self.first_slot[tile] as usize..self.first_slot[tile + 1] as usize
    }

    /// Splats in tile `tile`, front to back.
    pub fn members(&self, tile: usize) -> &[u32] {
        &self.splat_of_slot[self.slots(tile)]
    }

    /// Slots in which splat `splat` appears, in a fixed order.
    pub fn slots_of_splat(&self, splat: usize) -> &[u32] {
        &self.slot_of_instance[self.first_instance[splat] as usize..self.first_instance[splat + 1] as usize]
    }

    /// Top-left pixel of tile `tile`.
    pub fn origin(&self, tile: usize) -> (usize, usize) {
        (tile % self.columns * TILE, tile / self.columns * TILE)
    }
}

/// Indices of the splats, nearest first, ties by index.
fn by_depth(splats: &[Splat]) -> impl Iterator<Item = usize> {
    // The sort moves keys instead of splats.
    let key = |(index, splat): (usize, &Splat)| u64::from(splat.depth_key) << 32 | index as u64;
    let mut keys: Vec<u64> = splats.iter().enumerate().map(key).collect();
    keys.par_sort_unstable();
    keys.into_iter().map(|key| (key & 0xffff_ffff) as usize)
}

/// The tiles of some splats, splat by splat, and the number of tiles of each.
fn tiles_of(splats: &[Splat], columns: usize, rows: usize) -> (Vec<u32>, Vec<u32>) {
    let (mut tiles, mut counts) = (Vec::with_capacity(splats.len() * 3), Vec::with_capacity(splats.len()));
    for splat in splats {
        let before = tiles.len();
        for (x0, x1, row) in touched_rows(splat, columns, rows) {
            let touched = (x0..x1).filter(|column| touches(splat, *column, row));
            tiles.extend(touched.map(|column| (row * columns + column) as u32));
        }
        counts.push((tiles.len() - before) as u32);
    }
    (tiles, counts)
}

/// `(first column, end column, row)` of the tiles under the splat's bounding box.
fn touched_rows(
    s: &Splat,
    columns: usize,
    rows: usize,
) -> impl Iterator<Item = (usize, usize, usize)> + use<> {
    let span = |mean: f32, variance: f32, tiles: usize| {
        let extent = (2.0 * s.reach.max(0.0) * variance).sqrt();
        // The cast saturates, so far-away splats give empty or full spans instead of wrapping.
        let first = ((mean - extent - 0.5) / TILE as f32).floor().max(0.0) as usize;
        let end = ((mean + extent - 0.5) / TILE as f32 + 1.0).floor().max(0.0) as usize;
        (first.min(tiles), end.min(tiles))
    };
    let (x0, x1) = span(s.mean[0], s.covariance[0], columns);
    let (y0, y1) = span(s.mean[1], s.covariance[2], rows);
    (y0..y1.max(y0)).map(move |row| (x0, x1.max(x0), row))
}

/// Exact test: does alpha reach 1/255 anywhere in the rectangle of the tile's pixel centres?
fn touches(s: &Splat, column: usize, row: usize) -> bool {
    let lo = [(column * TILE) as f32 + 0.5 - s.mean[0], (row * TILE) as f32 + 0.5 - s.mean[1]];
    let hi = [lo[0] + (TILE - 1) as f32, lo[1] + (TILE - 1) as f32];
    least_power(s, lo, hi) <= s.reach
}

/// Smallest `0.5 d^T C d` over the box `lo..hi` of offsets from the mean, by the sum of squares that blending uses.
fn least_power(s: &Splat, lo: [f32; 2], hi: [f32; 2]) -> f32 {
    let ([a, b, c], root) = (s.conic, s.conic[0].sqrt());
    let power = |x: f32, y: f32| {
        let u = root * x + b / root * y;
        0.5 * (u * u + y * y / s.covariance[2])
    };
    let nearest = [0.0f32.clamp(lo[0], hi[0]), 0.0f32.clamp(lo[1], hi[1])];
    if nearest == [0.0, 0.0] {
        return 0.0;
    }
    // The convex minimum outside the box's centre lies on an edge that faces the mean.
    let on_vertical = power(nearest[0], (-b / c * nearest[0]).clamp(lo[1], hi[1]));
    let on_horizontal = power((-b / a * nearest[1]).clamp(lo[0], hi[0]), nearest[1]);
    match (nearest[0] != 0.0, nearest[1] != 0.0) {
        (true, true) => on_vertical.min(on_horizontal),
        (true, false) => on_vertical,
        _ => on_horizontal,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn splat(mean: [f32; 2], covariance: [f32; 3], opacity: f32) -> Splat {
        let [xx, xy, yy] = covariance;
        let d = xx * yy - xy * xy;
        Splat {
            gaussian: 0,
            mean,
            conic: [yy / d, -xy / d, xx / d],
            covariance,
            opacity,
            compensation: 1.0,
            reach: (255.0 * opacity).ln(),
            depth: 1.0,
            depth_key: 0,
        }
    }

    #[test]
    fn tile_test_never_misses_a_visible_pixel() {
        let cases = [
            splat([20.3, 17.9], [4.0, 0.0, 4.0], 0.5),
            splat([40.0, 25.0], [300.0, 290.0, 300.0], 0.9),
            splat([-10.0, 70.0], [90.0, -60.0, 50.0], 0.3),
            splat([32.0, 32.0], [0.3, 0.0, 0.3], 0.02),
        ];
        for s in cases {
            let lists = TileLists::new(64, 64, std::slice::from_ref(&s));
            for tile in 0..lists.len() {
                let (ox, oy) = lists.origin(tile);
                let reaches = (0..256).any(|i| {
                    let (x, y) = ((ox + i % 16) as f32 + 0.5, (oy + i / 16) as f32 + 0.5);
                    let (dx, dy) = (x - s.mean[0], y - s.mean[1]);
                    0.5 * (s.conic[0] * dx * dx + s.conic[2] * dy * dy) + s.conic[1] * dx * dy <= s.reach
                });
                if reaches {
                    assert_eq!(lists.members(tile), [0], "a visible pixel of tile {tile} was missed");
                }
            }
            let kept = (0..lists.len()).filter(|t| !lists.members(*t).is_empty()).count();
            assert!(kept < 16, "the test must cull something");
        }
    }

    #[test]
    fn tile_lists_are_sorted_by_depth_then_index() {
        let at = |depth_key| Splat { depth_key, ..splat([8.0, 8.0], [9.0, 0.0, 9.0], 0.9) };
        let lists = TileLists::new(16, 16, &[at(5), at(2), at(5), at(1)]);
        assert_eq!(lists.members(0), [3, 1, 0, 2]);
    }

    #[test]
    fn slots_and_splats_reference_each_other() {
        let splats = [splat([15.0, 15.0], [30.0, 0.0, 30.0], 0.9), splat([30.0, 8.0], [9.0, 0.0, 9.0], 0.9)];
        let lists = TileLists::new(48, 32, &splats);
        for splat in 0..2 {
            for &slot in lists.slots_of_splat(splat) {
                assert_eq!(lists.splat_of_slot[slot as usize] as usize, splat);
            }
        }
    }
}
