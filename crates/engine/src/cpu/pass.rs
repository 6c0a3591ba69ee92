//! One rasterisation: project, sort, bin and blend; and the backward pass to the parameters.

use crate::RasterCamera;
use rayon::prelude::*;

use crate::cpu::attributes::AttributeSource;
use crate::cpu::blend::{BlendScratch, TileJob, blend_tile};
use crate::cpu::blend_backward::{ABSGRAD, BackwardScratch, ROW_HEADER, blend_tile_backward};
use crate::cpu::lanes::LANES;
use crate::cpu::mixture::MixtureScratch;
use crate::cpu::project::{Splat, SplatGradient, project, project_backward, rotation_backward};
use crate::cpu::tiles::TileLists;
use crate::{Gradients, RowLayout, indirect_basis_backward, zeros};
use relume_layout::channel::{self, Channels, IncidentLight, RowLight};
use relume_layout::constants::{EarlyStop, TILE};
use relume_scene::light::LightTables;
use relume_scene::{Field, IndirectForm};

/// Gaussians per task; fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 512;
/// Largest number of tasks that differentiate the shading, each with its own gradient of the light tables, and least number of Gaussians
/// of such a task; fixed for the same reason. A task of few Gaussians would spend its time on its copy of the tables, a quarter of a megabyte.
const SHADING_TASKS: usize = 16;
const SHADING_CHUNK: usize = 2048;

/// A rasterised view: the G-buffer and everything its backward pass needs.
#[derive(Debug, Clone)]
pub struct Pass {
    /// The camera.
    pub view: RasterCamera,
    /// Visible splats, in the order of the Gaussians.
    pub splats: Vec<Splat>,
    /// Their tiles.
    pub tiles: TileLists,
    /// Channels of the pass.
    pub channels: Channels,
    /// Kind of light in the rows, where the channels include it.
    pub light: RowLight,
    /// Attribute rows by splat, `channels.stored()` floats each.
    pub attributes: Vec<f32>,
    /// `[tile][row][channel][lane]`.
    pub gbuffer: Vec<f32>,
    early_stop: EarlyStop,
}

impl Pass {
    /// Rasterises `source` as seen by `view`.
    pub fn forward(
        source: &AttributeSource<'_>,
        view: RasterCamera,
        channels: Channels,
        early_stop: EarlyStop,
    ) -> Self {
        let splats = project_all(source, &view);
        let stored = channels.stored();
        let attributes = attribute_rows(source, &view, &splats, channels, stored);
        let tiles = TileLists::new(view.width, view.height, &splats);
        Self::blend(view, (splats, tiles), channels, source.row_light(), attributes, early_stop)
    }

    /// Blends the given attribute rows over tiles of these splats, for callers that compute rows themselves.
    pub fn blend(
        view: RasterCamera,
        (splats, tiles): (Vec<Splat>, TileLists),
        channels: Channels,
        light: RowLight,
        attributes: Vec<f32>,
        early_stop: EarlyStop,
    ) -> Self {
        let stored = channels.stored();
        let mut gbuffer = zeros(tiles.len() * TILE * stored * LANES);
        gbuffer.par_chunks_mut(TILE * stored * LANES).enumerate().for_each_init(
            BlendScratch::default,
            |scratch, (tile, out)| {
                let members = tiles.members(tile);
                if members.is_empty() {
                    return;
                }
                let origin = tiles.origin(tile);
                let job =
                    TileJob { splats: &splats, members, attributes: &attributes, stored, origin, early_stop };
                blend_tile(&job, scratch, out);
            },
        );
        Self { view, splats, tiles, channels, light, attributes, gbuffer, early_stop }
    }

    /// Index of channel 0 of pixel (`x`, `y`) in a buffer of `stored` channels; channels are a strip (16 floats) apart.
    #[inline]
    pub fn locate(&self, x: usize, y: usize, stored: usize) -> usize {
        let tile = y / TILE * self.tiles.columns + x / TILE;
        (tile * TILE + y % TILE) * stored * LANES + x % TILE
    }

    /// Channel `channel` of pixel (`x`, `y`).
    #[inline]
    pub fn at(&self, x: usize, y: usize, channel: usize) -> f32 {
        self.gbuffer[self.locate(x, y, self.channels.stored()) + channel * LANES]
    }

    /// Gradients of all parameters from that of the first `count` G-buffer channels, laid out as the G-buffer with `stored`
    /// channels per pixel. The gradient of the light tables through Gaussians is added to `by_tables`; `env_raw` is unchanged.
    pub fn backward(
        &self,
        source: &AttributeSource<'_>,
        by_gbuffer: &[f32],
        stored: usize,
        count: usize,
        by_tables: Option<&mut LightTables>,
    ) -> Gradients {
        let width = ROW_HEADER + count;
        let mut summed = self.splat_gradients(by_gbuffer, stored, count);
        if let Some(by_tables) = by_tables {
            self.light_backward(source, &mut summed, width, by_tables);
            self.indirect_backward(source, &summed, width, by_tables);
        }
        let layout = RowLayout::differentiated(source.gaussians, count);
        let mut out = Gradients::laid_out(source.gaussians, layout, 0);
        self.attributes_backward(source, &summed, width, &mut out);
        out.prototypes = self.prototypes_backward(source, &summed, width);
        out
    }

    /// Gradients of the Gaussians' parameters from the splats' gradients, rows of `width` floats.
    fn attributes_backward(
        &self,
        source: &AttributeSource<'_>,
        summed: &[f32],
        width: usize,
        out: &mut Gradients,
    ) {
        let layout = out.layout;
        let mut splat_of = vec![u32::MAX; source.gaussians.len()];
        for (index, splat) in self.splats.iter().enumerate() {
            splat_of[splat.gaussian as usize] = index as u32;
        }
        let half_width = 0.5 * self.view.width.max(self.view.height) as f32;
        let has_albedo = width > ROW_HEADER + channel::ROUGH;
        let density = out.absgrad.par_chunks_mut(LANES).zip(out.visible.par_chunks_mut(LANES));
        let blocks = out.rows.par_chunks_mut(LANES * layout.row).zip(density).zip(splat_of.par_chunks(LANES));
        blocks.enumerate().with_min_len(4).for_each_init(
            MixtureScratch::default,
            |scratch, (block, ((rows, (absgrad, visible)), splats))| {
                let of_splat = |splat: &u32| summed.chunks_exact(width).nth(*splat as usize);
                if has_albedo {
                    let by_rows: Vec<Option<&[f32]>> =
                        splats.iter().map(|splat| of_splat(splat).map(|row| &row[ROW_HEADER..])).collect();
                    let first = (block * LANES) as u32;
                    let gaussians: Vec<u32> = (first..first + splats.len() as u32).collect();
                    let fields = [layout.range(Field::Residual), layout.range(Field::ProtoLogits)];
                    scratch.backward(source, &gaussians, &by_rows, fields, rows, layout.row);
                }
                for (lane, (row, index)) in rows.chunks_exact_mut(layout.row).zip(splats).enumerate() {
                    let (Some(splat), Some(summed)) = (self.splats.get(*index as usize), of_splat(index))
                    else {
                        continue;
                    };
                    absgrad[lane] = summed[ABSGRAD] * half_width;
                    visible[lane] = true;
                    // Other splats hide this one; NaN is not equal to 0.
                    if summed.iter().all(|g| *g == 0.0) {
                        continue;
                    }
                    self.geometry_backward(source, splat, summed, &layout, row);
                }
            },
        );
    }

    /// Chain rule from one splat's gradient, including its channels, to its Gaussian's gradient row, except albedo.
    fn geometry_backward(
        &self,
        source: &AttributeSource<'_>,
        splat: &Splat,
        summed: &[f32],
        layout: &RowLayout,
        row: &mut [f32],
    ) {
        let [mx, my, xx, xy, yy, opacity] = std::array::from_fn(|k| summed[k]);
        let gradient = SplatGradient { mean: [mx, my], conic: [xx, xy, yy], opacity };
        let geometry = source.geometry(splat.gaussian as usize);
        let mut by = project_backward(&self.view, &geometry, splat, &gradient);
        source.write_backward(&self.view, splat, &summed[ROW_HEADER..], layout, &mut by, row);
        let quaternion = rotation_backward(geometry.quaternion, &by.rotation);
        let mut add = |field: Field, values: &[f32]| {
            row[layout.range(field)].iter_mut().zip(values).for_each(|(o, v)| *o += v);
        };
        add(Field::Mean, &by.mean);
        add(Field::LogScale, &by.log_scale);
        add(Field::Quaternion, &quaternion);
        add(Field::OpacityLogit, &[by.opacity_logit]);
    }

    /// Chain rule through the light of the Gaussians. Adds to the splat gradients, rows of `width` floats, and to
    /// `by_tables`.
    pub(crate) fn light_backward(
        &self,
        source: &AttributeSource<'_>,
        summed: &mut [f32],
        width: usize,
        by_tables: &mut LightTables,
    ) {
        if source.light.is_none() {
            return;
        }
        let stored = self.channels.stored();
        let chunk = self.splats.len().div_ceil(SHADING_TASKS).max(SHADING_CHUNK);
        let add = |splats: &[Splat], rows: &[f32], summed: &mut [f32], tables: &mut LightTables| {
            let rows = rows.chunks_exact(stored).zip(summed.chunks_exact_mut(width));
            for (splat, (row, by_row)) in splats.iter().zip(rows) {
                let (header, by_row) = by_row.split_at_mut(ROW_HEADER);
                source.light_backward(&self.view, splat, row, (&mut header[..2], by_row), tables);
            }
        };
        if self.splats.len() <= chunk {
            return add(&self.splats, &self.attributes, summed, by_tables);
        }
        let splats = self.splats.par_chunks(chunk);
        let rows = self.attributes.par_chunks(chunk * stored);
        let partial: Vec<LightTables> = splats
            .zip(rows)
            .zip(summed.par_chunks_mut(chunk * width))
            .map(|((splats, rows), summed)| {
                let mut tables = by_tables.zeroed();
                add(splats, rows, summed, &mut tables);
                tables
            })
            .collect();
        partial.iter().for_each(|p| by_tables.accumulate(p));
    }

    /// Adds the gradient of the light through `E_j` (Eq. 20), where indirect light is learned and differentiated. The
    /// gradient by `E_j` is the sum over Gaussians of weight x channel gradient.
    fn indirect_backward(
        &self,
        source: &AttributeSource<'_>,
        summed: &[f32],
        width: usize,
        by_tables: &mut LightTables,
    ) {
        let blocked = ROW_HEADER + IncidentLight::BLOCKED.start..ROW_HEADER + IncidentLight::BLOCKED.end;
        if source.options.indirect != IndirectForm::Learned || width < blocked.end {
            return;
        }
        let mut by_basis = [[0.0f32; 3]; 16];
        for (splat, row) in self.splats.iter().zip(summed.chunks_exact(width)) {
            let weights = source.gaussians.row(Field::Indirect, splat.gaussian as usize);
            for (o, w) in by_basis.iter_mut().zip(weights) {
                o.iter_mut().zip(&row[blocked.clone()]).for_each(|(o, g)| *o += w * g);
            }
        }
        indirect_basis_backward(&by_basis, by_tables);
    }

    /// The gradient of each splat, summed over its tiles: mean, conic, opacity, absgrad, then `count` channels.
    pub fn splat_gradients(&self, by_gbuffer: &[f32], stored: usize, count: usize) -> Vec<f32> {
        self.sum_instances(&self.blend_backward(by_gbuffer, stored, count), ROW_HEADER + count)
    }

    fn blend_backward(&self, by_gbuffer: &[f32], stored: usize, count: usize) -> Vec<f32> {
        let width = ROW_HEADER + count;
        let mut rows = zeros(self.tiles.splat_of_slot.len() * width);
        let mut parts = Vec::with_capacity(self.tiles.len());
        let mut rest = rows.as_mut_slice();
        for tile in 0..self.tiles.len() {
            let (part, tail) = rest.split_at_mut(self.tiles.slots(tile).len() * width);
            parts.push(part);
            rest = tail;
        }
        parts.into_par_iter().enumerate().for_each_init(BackwardScratch::default, |scratch, (tile, out)| {
            let members = self.tiles.members(tile);
            if members.is_empty() {
                return;
            }
            let job = TileJob {
                splats: &self.splats,
                members,
                attributes: &self.attributes,
                stored: self.channels.stored(),
                origin: self.tiles.origin(tile),
                early_stop: self.early_stop,
            };
            let gradient = &by_gbuffer[tile * TILE * stored * LANES..(tile + 1) * TILE * stored * LANES];
            blend_tile_backward(&job, gradient, stored, count, scratch, out);
        });
        rows
    }

    /// Each splat's gradient summed over its tiles, in tile order.
    fn sum_instances(&self, rows: &[f32], width: usize) -> Vec<f32> {
        let mut summed = zeros(self.splats.len() * width);
        summed.par_chunks_mut(width).enumerate().with_min_len(64).for_each(|(splat, out)| {
            for &slot in self.tiles.slots_of_splat(splat) {
                let row = &rows[slot as usize * width..(slot as usize + 1) * width];
                out.iter_mut().zip(row).for_each(|(o, v)| *o += v);
            }
        });
        summed
    }

    fn prototypes_backward(
        &self,
        source: &AttributeSource<'_>,
        summed: &[f32],
        width: usize,
    ) -> Vec<[f32; 3]> {
        let count = source.prototypes.len();
        if width <= ROW_HEADER + channel::ROUGH {
            return vec![[0.0; 3]; count];
        }
        let partial: Vec<[Vec<f32>; 3]> = self
            .splats
            .par_chunks(CHUNK)
            .zip(summed.par_chunks(CHUNK * width))
            .map_init(MixtureScratch::default, |scratch, (splats, rows)| {
                let mut out = [0; 3].map(|_| vec![0.0f32; count]);
                for (splats, rows) in splats.chunks(LANES).zip(rows.chunks(LANES * width)) {
                    let rows: Vec<Option<&[f32]>> =
                        rows.chunks_exact(width).map(|row| Some(&row[ROW_HEADER..])).collect();
                    scratch.prototypes_backward(source, &gaussians_of(splats), &rows, &mut out);
                }
                out
            })
            .collect();
        let mut sum = vec![[0.0f32; 3]; count];
        for part in &partial {
            for (k, s) in sum.iter_mut().enumerate() {
                (0..3).for_each(|c| s[c] += part[c][k]);
            }
        }
        // A prototype outside of [0, 1] is clamped, and the clamp passes no gradient.
        for (s, a) in sum.iter_mut().zip(source.prototypes) {
            *s = std::array::from_fn(|c| if a[c] > 0.0 && a[c] < 1.0 { s[c] } else { 0.0 });
        }
        sum
    }
}

fn gaussians_of(splats: &[Splat]) -> Vec<u32> {
    splats.iter().map(|s| s.gaussian).collect()
}

/// The attributes of every splat in `channels`, in rows of `stored` floats; the remaining floats are zero.
pub fn attribute_rows(
    source: &AttributeSource<'_>,
    view: &RasterCamera,
    splats: &[Splat],
    channels: Channels,
    stored: usize,
) -> Vec<f32> {
    let mut rows = zeros(splats.len() * stored);
    let blocks = rows.par_chunks_mut(LANES * stored).zip(splats.par_chunks(LANES)).with_min_len(4);
    blocks.for_each_init(MixtureScratch::default, |scratch, (rows, splats)| {
        if channels.count() > channel::ROUGH {
            scratch.write(source, &gaussians_of(splats), rows, stored);
        }
        for (row, splat) in rows.chunks_exact_mut(stored).zip(splats) {
            source.write(view, splat, channels, row);
        }
    });
    rows
}

/// Every visible Gaussian as a splat, in the order of the Gaussians, so that reads and writes by splat are contiguous.
pub fn project_all(source: &AttributeSource<'_>, view: &RasterCamera) -> Vec<Splat> {
    (0..source.gaussians.len())
        .into_par_iter()
        .with_min_len(256)
        .filter_map(|i| project(view, i as u32, &source.geometry(i)))
        .collect()
}
