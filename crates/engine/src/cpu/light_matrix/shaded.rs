//! The radiance of Gaussians towards the camera for a group of columns (docs/MODEL.md, section 4).

use rayon::prelude::*;

use crate::cpu::direct::direct_of;
use crate::cpu::light_matrix::gathered::Incident;
use crate::cpu::light_matrix::kernels::{add_irradiance, add_prefiltered, add_scaled};
use crate::cpu::light_matrix::{Columns, LightMatrix};
use crate::cpu::project::normalise;
use crate::cpu::shown_splats::ShownSplats;
use crate::cpu::surface::dot3;
use crate::cpu::{AttributeSource, ShadedColumns, Surface, SurfaceShader};
use crate::zeros;
use relume_layout::channel::GROUP;
use relume_layout::constants::MIN_NOV;
use relume_scene::light::{BrdfLut, DIELECTRIC_F0, LevelPosition, Sheen, UNOCCLUDED_SH0};
use relume_scene::{DisplayRange, Field};

/// Splats of one parallel task.
const SPLATS_AT_ONCE: usize = 128;

/// Shades the shown splats of `matrix` for `columns`.
pub(super) fn shade(
    matrix: &LightMatrix<'_>,
    source: &AttributeSource<'_>,
    columns: &Columns,
    incident: &Incident,
) -> ShadedColumns {
    let light = matrix.light;
    let shader = SurfaceShader {
        tables: &light.unlit,
        options: source.options,
        sh_degree: light.sh_degree,
        range: DisplayRange::Unit,
    };
    let shading = Shading { matrix, source, columns, incident, shader };
    let (channels, stored) = (3 * columns.len(), (3 * columns.len()).next_multiple_of(GROUP));
    let splats = &matrix.splats;
    let mut attributes = zeros(splats.splats.len() * stored);
    let rows = splats.rows_of_shown(&mut attributes, stored);
    let shown =
        rows.into_par_iter().zip(&splats.shown).zip(splats.materials.par_chunks(ShownSplats::MATERIAL));
    shown.with_min_len(SPLATS_AT_ONCE).for_each_init(Sums::default, |sums, ((row, splat), material)| {
        let i = splats.splats[*splat as usize].gaussian as usize;
        shading.write(i, material, sums, &mut row[..channels]);
    });
    ShadedColumns { channels, stored, attributes }
}

/// One number per lobe.
#[derive(Debug, Default)]
struct Sums {
    irradiance: Vec<f32>,
    prefiltered: Vec<f32>,
    blocked: Vec<f32>,
}

impl Sums {
    fn clear(&mut self, columns: usize) {
        for sums in [&mut self.irradiance, &mut self.prefiltered, &mut self.blocked] {
            sums.clear();
            sums.resize(columns, 0.0);
        }
    }
}

struct Shading<'a> {
    matrix: &'a LightMatrix<'a>,
    source: &'a AttributeSource<'a>,
    columns: &'a Columns,
    incident: &'a Incident,
    shader: SurfaceShader<'a>,
}

/// The factors of a surface, independent of the light.
struct Factors {
    /// Unit normal turned to the camera.
    normal: [f32; 3],
    nov: f32,
    /// Diffuse radiance per irradiance.
    diffuse: [f32; 3],
    /// Specular radiance per radiance from the open part of the lobe.
    specular: [f32; 3],
    /// Share of the lobe of reflection that is open.
    visible: f32,
    /// Factor of the irradiance of the lobes.
    ambient: f32,
    reflection: [f32; 3],
    position: LevelPosition<f32>,
}

impl Factors {
    fn of(shader: &SurfaceShader<'_>, s: &Surface) -> Self {
        let (mut normal, _) = normalise(s.normal);
        let facing = dot3(normal, s.view);
        if facing < 0.0 {
            normal = normal.map(|v| -v);
        }
        let nov = facing.abs().clamp(MIN_NOV, 1.0);
        let (reflection, _) = normalise(std::array::from_fn(|k| 2.0 * nov * normal[k] - s.view[k]));
        let lut = BrdfLut::shared().sample(nov, s.rough);
        let share = lut.diffuse_share(shader.options.conserves_energy);
        let of_diffuse =
            (1.0 - s.metal) * std::f32::consts::FRAC_1_PI * Sheen::new(s.sheen, nov).gain * share.value;
        let f0 = |c: usize| DIELECTRIC_F0 * (1.0 - s.metal) + s.albedo[c] * s.metal;
        let is_scalar = shader.is_scalar() && !shader.is_open();
        Self {
            normal,
            nov,
            diffuse: s.albedo.map(|a| a * of_diffuse),
            specular: std::array::from_fn(|c| f0(c) * lut.value[0] + lut.value[1]),
            visible: shader.visible(s, reflection).0,
            ambient: if is_scalar { shader.ambient_occlusion(&s.visibility, normal) } else { 1.0 },
            reflection,
            position: LevelPosition::of(s.rough),
        }
    }
}

impl Shading<'_> {
    /// Writes the radiance of Gaussian `i` with attributes `material`: RGB per column.
    fn write(&self, i: usize, material: &[f32], sums: &mut Sums, out: &mut [f32]) {
        let centre = self.matrix.splats.view.centre;
        let mean = self.source.geometry(i).mean;
        let surface = self.source.surface(i, material, std::array::from_fn(|k| mean[k] - centre[k]));
        let factors = Factors::of(&self.shader, &surface);
        self.sum_lobes(i, &factors, sums);
        let (open, hidden) = (factors.visible, 1.0 - factors.visible);
        let triples = out.as_chunks_mut::<3>().0.iter_mut().zip(&sums.irradiance).zip(&sums.prefiltered);
        for ((out, irradiance), prefiltered) in triples {
            let (irradiance, arriving) = (irradiance * factors.ambient, open * prefiltered);
            *out = std::array::from_fn(|c| factors.diffuse[c] * irradiance + factors.specular[c] * arriving);
        }
        self.add_suns(&surface, &factors, &mut out[3 * self.columns.lobes.len()..]);
        let of_blocked = factors.specular.map(|v| v * hidden);
        match self.incident {
            Incident::Off => {}
            Incident::Learned(_) => {
                for (out, blocked) in out.as_chunks_mut::<3>().0.iter_mut().zip(&sums.blocked) {
                    (0..3).for_each(|c| out[c] += of_blocked[c] * blocked);
                }
            }
            Incident::Gathered { irradiance, blocked } => {
                let rows = i * out.len()..(i + 1) * out.len();
                let incident = irradiance[rows.clone()].as_chunks::<3>().0.iter();
                let incident = incident.zip(blocked[rows].as_chunks::<3>().0);
                for (out, (irradiance, blocked)) in out.as_chunks_mut::<3>().0.iter_mut().zip(incident) {
                    for c in 0..3 {
                        out[c] += factors.diffuse[c] * irradiance[c] + of_blocked[c] * blocked[c];
                    }
                }
            }
        }
    }

    /// Irradiance and prefiltered radiance of the lobes, and learned blocked radiance, at Gaussian `i`.
    fn sum_lobes(&self, i: usize, factors: &Factors, sums: &mut Sums) {
        let (lobes, tables) = (&self.columns.lobes, &self.matrix.light.lobes);
        sums.clear(self.columns.len());
        let coefficients = match self.shader.is_scalar() {
            true => &[UNOCCLUDED_SH0][..],
            false => self.source.gaussians.row(Field::Visibility, i),
        };
        let taps = tables.diffuse_grid.lookup(factors.normal);
        add_irradiance(tables, &taps, coefficients, lobes, &mut sums.irradiance[..lobes.len()]);
        let LevelPosition { level, fraction, .. } = factors.position;
        for (level, share) in [(level, 1.0 - fraction), (level + 1, fraction)] {
            if share > 0.0 {
                let taps = tables.specular_grids[level].lookup(factors.reflection);
                let out = &mut sums.prefiltered[..lobes.len()];
                add_prefiltered(tables, (level, share), &taps, lobes, out);
            }
        }
        if let Incident::Learned(basis) = self.incident {
            let weights = self.source.gaussians.row(Field::Indirect, i);
            for (weight, row) in weights.iter().zip(basis.chunks_exact(self.columns.len().max(1))) {
                add_scaled(*weight, row, &mut sums.blocked);
            }
        }
    }

    /// Adds the light that arrives straight from the small lights.
    fn add_suns(&self, surface: &Surface, factors: &Factors, out: &mut [f32]) {
        for (k, out) in self.columns.suns.clone().zip(out.as_chunks_mut::<3>().0) {
            let (light, arriving) = (&self.matrix.light.unlit.lights[k], surface.arriving[k]);
            let Some(direct) = direct_of(surface, (factors.normal, factors.nov), light, arriving) else {
                continue;
            };
            for c in 0..3 {
                out[c] += factors.diffuse[c] * direct.irradiance[c] + direct.specular[c];
            }
        }
    }
}
