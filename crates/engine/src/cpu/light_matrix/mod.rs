//! The frames of a model under each lobe of light and each of some small lights, all at once (docs/guide/light_matrix.md).
//!
//! Projection, tiles, materials and occlusion are computed once. Columns (lobes and small lights) are shaded in groups that fit a
//! bound of memory: each Gaussian for all columns of a group, then each tile in one pass with three channels per column. The
//! computation is linear in the light: it has none of the clamps of irradiance at 0 that frames have, so values can be a little
//! negative, and weighted sums of the frames are frames under the weighted light.

mod gathered;
mod kernels;
mod shaded;

use std::ops::Range;

use crate::cpu::shown_splats::ShownSplats;
use crate::cpu::{AttributeSource, HostModel, ShadedColumns, arriving};
use crate::{NO_INDIRECT_BASIS, RasterCamera};
use relume_scene::light::{LightLobes, LightTables, LobeTables, TableLight};
use relume_scene::{MAX_LIGHTS, SplitLight};

/// Greatest number of columns of a group.
const GROUP: usize = 32;
/// A group has a multiple of this number of columns, except the last, so that blending works in whole blocks of channels.
const BLOCK: usize = 4;
/// Bytes of intermediate data of a group, beyond which it has fewer columns.
const GROUP_BYTES: usize = 512 << 20;
/// Bytes per Gaussian and column of a group: irradiance, light of other surfaces from two bounces, radiance.
const COLUMN_BYTES: usize = 4 + 4 * 12;

/// The lights of a matrix: lobes of radiance 1, then small lights of irradiance 1 in each channel.
#[derive(Debug, Clone)]
pub struct MatrixLight {
    lobes: LobeTables,
    suns: Vec<SplitLight>,
    /// Grids and small lights, without the light of the lobes.
    unlit: LightTables,
    sh_degree: usize,
}

impl MatrixLight {
    /// The lights for visibility fields of degree `sh_degree`. At most [`MAX_LIGHTS`] small lights are used.
    pub fn new(lobes: &LightLobes, mut suns: Vec<SplitLight>, sh_degree: usize) -> Self {
        suns.truncate(MAX_LIGHTS);
        let lobes = LobeTables::new(lobes, sh_degree);
        let of = |sun: &SplitLight| TableLight {
            direction: sun.direction,
            radius: sun.radius,
            irradiance: [1.0; 3],
        };
        let unlit = LightTables {
            diffuse_grid: lobes.diffuse_grid,
            coefficients: 0,
            diffuse: Vec::new(),
            specular_grids: lobes.specular_grids,
            specular: Default::default(),
            lights: suns.iter().map(of).collect(),
        };
        Self { lobes, suns, unlit, sh_degree }
    }

    /// Number of columns: lobes and small lights.
    pub fn columns(&self) -> usize {
        self.lobes.lobes() + self.suns.len()
    }
}

/// Lobes and small lights of a group of columns.
#[derive(Debug, Clone)]
struct Columns {
    lobes: Range<usize>,
    suns: Range<usize>,
}

impl Columns {
    fn of(columns: &Range<usize>, lobes: usize) -> Self {
        Self {
            lobes: columns.start.min(lobes)..columns.end.min(lobes),
            suns: columns.start.max(lobes) - lobes..columns.end.max(lobes) - lobes,
        }
    }

    fn len(&self) -> usize {
        self.lobes.len() + self.suns.len()
    }
}

/// A model seen by one camera, ready to be shaded for groups of columns.
pub struct LightMatrix<'a> {
    host: &'a HostModel,
    light: &'a MatrixLight,
    /// Share of each small light that arrives, per Gaussian.
    arriving: Vec<[f32; MAX_LIGHTS]>,
    splats: ShownSplats,
}

impl HostModel {
    /// Prepares the frames that `view` shows under each of `light`. Models whose surfaces are shaded in the pixel are shaded at their
    /// Gaussians here, as in the tier `preview`.
    pub fn light_matrix<'a>(&'a self, light: &'a MatrixLight, view: RasterCamera) -> LightMatrix<'a> {
        let source = self.source(&[], &[], &NO_INDIRECT_BASIS);
        let arriving = arriving(&source, &light.suns);
        let splats = ShownSplats::new(&source, view);
        LightMatrix { host: self, light, arriving, splats }
    }
}

impl LightMatrix<'_> {
    /// The groups of columns, in order; together all columns.
    pub fn groups(&self) -> Vec<Range<usize>> {
        let fit = GROUP_BYTES / (COLUMN_BYTES * self.host.model().gaussians.len().max(1));
        let size = (fit / BLOCK * BLOCK).clamp(BLOCK, GROUP);
        let columns = self.light.columns();
        (0..columns).step_by(size).map(|first| first..(first + size).min(columns)).collect()
    }

    /// Number of strips of a frame: runs of 16 rows.
    pub fn strips(&self) -> usize {
        self.splats.strips()
    }

    /// Number of rows of strip `index`.
    pub fn strip_rows(&self, index: usize) -> usize {
        self.splats.strip_rows(index)
    }

    /// Coverage of the splats, one channel.
    pub fn coverage(&self) -> ShadedColumns {
        let attributes = self.splats.splats.iter().flat_map(|_| [1.0, 0.0, 0.0, 0.0]).collect();
        ShadedColumns { channels: 1, stored: 4, attributes }
    }

    /// Shades the splats for `columns`, one of [`Self::groups`].
    pub fn shade(&self, columns: Range<usize>) -> ShadedColumns {
        let columns = Columns::of(&columns, self.light.lobes.lobes());
        let source = self.source();
        let incident = gathered::Incident::of(self.host, &source, self.light, &columns);
        shaded::shade(self, &source, &columns, &incident)
    }

    /// Strip `index` of the frames of `shaded`: linear radiance, premultiplied, as `[channel][row][column of pixels]`, with three
    /// channels per column of the matrix.
    pub fn strip(&self, shaded: &ShadedColumns, index: usize) -> Vec<f32> {
        self.splats.strip(shaded, index)
    }

    /// The model with the shares of the small lights.
    fn source(&self) -> AttributeSource<'_> {
        self.host.source(&[], &self.arriving, &NO_INDIRECT_BASIS)
    }
}
