//! The light that arrives at Gaussians from other Gaussians, and the shadows of the sky, for a group of columns (docs/MODEL.md,
//! section 6). Linear in the light: irradiance is not clamped at 0.

use rayon::prelude::*;

use crate::cpu::gather::diffuse_reflectances;
use crate::cpu::light_matrix::kernels::{add_directions, add_irradiance, add_prefiltered, add_scaled};
use crate::cpu::light_matrix::{Columns, MatrixLight};
use crate::cpu::{AttributeSource, HostModel, SkyShadows, Transport};
use crate::indirect::INDIRECT_DIRECTIONS;
use crate::{BOUNCES, fibonacci_sphere, zeros};
use relume_layout::constants::SKY_SHADOW_LEVEL;
use relume_scene::light::{UNOCCLUDED_SH0, sh_eval};
use relume_scene::{Field, IndirectForm, VisibilityForm};

type Vec3 = [f32; 3];

/// Gaussians of one parallel task.
const GAUSSIANS_AT_ONCE: usize = 128;

/// The light from other surfaces.
pub(super) enum Incident {
    /// None.
    Off,
    /// `E_j` of Eq. 20, 16 rows of one number per column.
    Learned(Vec<f32>),
    /// Rows of Gaussians with RGB per column.
    Gathered {
        /// Irradiance, with the shadows of the sky.
        irradiance: Vec<f32>,
        /// Mean radiance over blocked directions.
        blocked: Vec<f32>,
    },
}

impl Incident {
    /// The light of `columns` between the surfaces of `source`.
    pub(super) fn of(
        host: &HostModel,
        source: &AttributeSource<'_>,
        light: &MatrixLight,
        columns: &Columns,
    ) -> Self {
        match source.options.indirect {
            IndirectForm::Off => Self::Off,
            IndirectForm::Learned => Self::Learned(learned_basis(light, columns)),
            IndirectForm::Gathered => {
                let occlusion = host.occlusion(source);
                let gathering = Gathering { source, light, columns, transport: &occlusion.transport };
                let (mut irradiance, blocked) = gathering.gather();
                if let Some(sky) = &occlusion.sky {
                    add_sky_shadows(sky, light, columns, &mut irradiance);
                }
                Self::Gathered { irradiance, blocked }
            }
        }
    }
}

struct Gathering<'a> {
    source: &'a AttributeSource<'a>,
    light: &'a MatrixLight,
    columns: &'a Columns,
    transport: &'a Transport,
}

impl Gathering<'_> {
    /// Irradiance and mean blocked radiance after all bounces.
    fn gather(&self) -> (Vec<f32>, Vec<f32>) {
        let (width, count) = (3 * self.columns.len(), self.source.gaussians.len());
        let reflectances = diffuse_reflectances(self.source);
        let mut direct = zeros(count * self.columns.len());
        let rows = direct.par_chunks_mut(self.columns.len()).enumerate();
        rows.with_min_len(GAUSSIANS_AT_ONCE).for_each(|(i, out)| self.add_direct(i, out));
        let (mut irradiance, mut emitted) = (zeros(count * width), zeros(count * width));
        for bounce in 0..BOUNCES {
            let rows = emitted.par_chunks_mut(width).zip(direct.par_chunks(self.columns.len()));
            let rows = rows.zip(irradiance.par_chunks(width)).zip(&reflectances).with_min_len(1024);
            rows.for_each(|(((out, direct), gathered), reflectance)| {
                let triples = out.as_chunks_mut::<3>().0.iter_mut().zip(gathered.as_chunks::<3>().0);
                for ((out, gathered), direct) in triples.zip(direct) {
                    *out = std::array::from_fn(|c| reflectance[c] * (direct + gathered[c]));
                }
            });
            if bounce + 1 == BOUNCES {
                break;
            }
            self.collect(&emitted, &mut irradiance, |link| link.irradiance);
        }
        self.collect(&emitted, &mut irradiance, |link| link.irradiance);
        let mut blocked = zeros(count * width);
        self.collect(&emitted, &mut blocked, |link| link.share);
        blocked.par_chunks_mut(width).enumerate().with_min_len(1024).for_each(|(i, row)| {
            let shares: f32 = self.transport.links_of(i).iter().map(|link| link.share).sum();
            if shares > 0.0 {
                row.iter_mut().for_each(|v| *v /= shares);
            }
        });
        (irradiance, blocked)
    }

    /// Sums what the blocking Gaussians emit, each times `factor`, over the links of each Gaussian.
    fn collect(
        &self,
        emitted: &[f32],
        out: &mut [f32],
        factor: impl Fn(&crate::cpu::gather::Link) -> f32 + Sync,
    ) {
        let width = 3 * self.columns.len();
        out.par_chunks_mut(width).enumerate().with_min_len(GAUSSIANS_AT_ONCE).for_each(|(i, out)| {
            out.fill(0.0);
            for link in self.transport.links_of(i).iter().filter(|link| link.irradiance > 0.0) {
                let from = link.from as usize;
                add_scaled(factor(link), &emitted[from * width..(from + 1) * width], out);
            }
        });
    }

    /// Adds the irradiance of Gaussian `i` on its outward side, without other surfaces.
    fn add_direct(&self, i: usize, out: &mut [f32]) {
        let normal = self.transport.normals()[i];
        let (of_lobes, of_suns) = out.split_at_mut(self.columns.lobes.len());
        let taps = self.light.lobes.diffuse_grid.lookup(normal);
        let open = self.source.options.visibility == VisibilityForm::Off;
        let coefficients = match open {
            true => &[UNOCCLUDED_SH0][..],
            false => self.source.gaussians.row(Field::Visibility, i),
        };
        add_irradiance(&self.light.lobes, &taps, coefficients, &self.columns.lobes, of_lobes);
        let arriving = self.source.arriving_at(i);
        for (k, out) in self.columns.suns.clone().zip(of_suns) {
            *out = arriving[k] * dot(normal, self.light.suns[k].direction).max(0.0);
        }
    }
}

/// Adds the difference between the irradiance through the transmittance in single directions and that through the visibility field.
fn add_sky_shadows(sky: &SkyShadows, light: &MatrixLight, columns: &Columns, irradiance: &mut [f32]) {
    let lobes = columns.lobes.len();
    if lobes == 0 {
        return;
    }
    let mut radiance = vec![0.0f32; sky.directions().len() * lobes];
    for (direction, out) in sky.directions().iter().zip(radiance.chunks_exact_mut(lobes)) {
        let taps = light.lobes.specular_grids[SKY_SHADOW_LEVEL].lookup(*direction);
        add_prefiltered(&light.lobes, (SKY_SHADOW_LEVEL, sky.weight()), &taps, &columns.lobes, out);
    }
    let rows = irradiance.par_chunks_mut(3 * columns.len()).enumerate().with_min_len(GAUSSIANS_AT_ONCE);
    rows.for_each_init(
        || vec![0.0f32; lobes],
        |sums, (i, row)| {
            sums.fill(0.0);
            add_directions(sky.factors_of(i), &radiance, sums);
            for (triple, sum) in row.as_chunks_mut::<3>().0.iter_mut().zip(sums.iter()) {
                triple.iter_mut().for_each(|v| *v += sum);
            }
        },
    );
}

/// `E_j` of Eq. 20 for each column; 0 for small lights.
fn learned_basis(light: &MatrixLight, columns: &Columns) -> Vec<f32> {
    let (last, width) = (light.lobes.specular_grids.len() - 1, columns.len());
    let mut out = vec![0.0f32; 16 * width];
    for d in fibonacci_sphere(INDIRECT_DIRECTIONS) {
        let mut y = [0.0f32; 16];
        sh_eval(3, d, &mut y);
        let taps = light.lobes.specular_grids[last].lookup(d);
        for (row, y) in out.chunks_exact_mut(width.max(1)).zip(y) {
            let factor = y / INDIRECT_DIRECTIONS as f32;
            let of_lobes = &mut row[..columns.lobes.len()];
            add_prefiltered(&light.lobes, (last, factor), &taps, &columns.lobes, of_lobes);
        }
    }
    out
}

fn dot(a: Vec3, b: Vec3) -> f32 {
    (0..3).map(|k| a[k] * b[k]).sum()
}
