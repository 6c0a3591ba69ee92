//! Shadows of the sky that the visibility field blurs: the irradiance through the transmittance in single directions, minus that
//! through the field (docs/MODEL.md, section 6).

use rayon::prelude::*;

use crate::cpu::Probes;
use crate::cpu::attributes::AttributeSource;
use crate::cpu::gather::through_visibility;
use relume_layout::constants::SKY_SHADOW_LEVEL;
use relume_scene::Field;
use relume_scene::light::{LightTables, sh_eval};

type Vec3 = [f32; 3];

/// Resolution of a factor. A field that differs by more than 8 from the transmittance is clamped.
const STEP: f32 = 8.0 / 32_767.0;
/// Number of Gaussians of one parallel task.
const GAUSSIANS_AT_ONCE: usize = 256;

/// The difference between measured transmittance and the visibility field; independent of the light.
#[derive(Debug, Clone)]
pub struct SkyShadows {
    /// Shading normals on the outward side.
    normals: Vec<Vec3>,
    directions: Vec<Vec3>,
    /// `[Gaussian][direction]`: `(V - field) (n . w)+`, in steps of [`STEP`].
    factors: Vec<i16>,
}

impl SkyShadows {
    /// The differences of `probes` from the visibility field of `source`. `outward`: outward normals of the measurement.
    pub fn new(source: &AttributeSource<'_>, probes: &Probes, outward: &[Vec3]) -> Self {
        let g = source.gaussians;
        let basis: Vec<[f32; 64]> =
            probes.directions.iter().map(|d| basis(g.visibility_degree(), *d)).collect();
        let normals: Vec<Vec3> =
            outward.iter().enumerate().map(|(i, n)| source.normal_towards(i, *n)).collect();
        let mut factors = vec![0i16; g.len() * probes.directions.len()];
        let rows = factors.par_chunks_mut(probes.directions.len().max(1)).enumerate();
        rows.with_min_len(GAUSSIANS_AT_ONCE).for_each(|(i, row)| {
            let (field, normal) = (g.row(Field::Visibility, i), normals[i]);
            for (k, factor) in row.iter_mut().enumerate() {
                let facing = dot(normal, probes.directions[k]);
                if facing > 0.0 {
                    let soft: f32 = field.iter().zip(&basis[k]).map(|(c, y)| c * y).sum();
                    // The conversion saturates.
                    *factor = (facing * (probes.transmittance[k][i] - soft) / STEP).round() as i16;
                }
            }
        });
        Self { normals, directions: probes.directions.clone(), factors }
    }

    /// The measured directions.
    pub(super) fn directions(&self) -> &[Vec3] {
        &self.directions
    }

    /// Irradiance per radiance and factor.
    pub(super) fn weight(&self) -> f32 {
        STEP * 4.0 * std::f32::consts::PI / self.directions.len().max(1) as f32
    }

    /// The factor of each direction of Gaussian `i`, for the radiance of that direction times [`Self::weight`].
    pub(super) fn factors_of(&self, i: usize) -> &[i16] {
        &self.factors[i * self.directions.len()..(i + 1) * self.directions.len()]
    }

    /// `gathered` with the difference of irradiance under the light of `tables`. The irradiance through the field and the difference are
    /// together never negative.
    #[must_use]
    pub fn added_to(
        &self,
        mut gathered: Vec<[f32; 6]>,
        source: &AttributeSource<'_>,
        tables: &LightTables,
    ) -> Vec<[f32; 6]> {
        let weight = self.weight();
        let scaled = |d: &Vec3| radiance(tables, *d).map(|l| weight * l);
        let light: Vec<Vec3> = self.directions.iter().map(scaled).collect();
        let rows = gathered.par_iter_mut().zip(self.factors.par_chunks(light.len().max(1))).enumerate();
        rows.with_min_len(GAUSSIANS_AT_ONCE).for_each(|(i, (gathered, factors))| {
            let mut sum = [0.0f32; 3];
            for (factor, light) in factors.iter().zip(&light) {
                (0..3).for_each(|c| sum[c] += f32::from(*factor) * light[c]);
            }
            let sky = through_visibility(source, tables, self.normals[i], i);
            (0..3).for_each(|c| gathered[c] += sum[c].max(-sky[c]));
        });
        gathered
    }
}

/// Mean radiance of the light of `tables` around a direction.
fn radiance(tables: &LightTables, direction: Vec3) -> Vec3 {
    let taps = tables.specular_grids[SKY_SHADOW_LEVEL].lookup(direction);
    let nodes = &tables.specular[SKY_SHADOW_LEVEL];
    std::array::from_fn(|c| (0..4).map(|k| taps.weight[k] * nodes[taps.node[k]][c]).sum())
}

fn basis(sh_degree: usize, direction: Vec3) -> [f32; 64] {
    let mut y = [0.0f32; 64];
    sh_eval(sh_degree, direction, &mut y);
    y
}

fn dot(a: Vec3, b: Vec3) -> f32 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fibonacci_sphere;
    use relume_layout::constants::NO_HIT;
    use relume_scene::light::rendering_tables;
    use relume_scene::{EnvMap, Gaussians, ShadingOptions};

    const DEGREE: usize = 4;

    /// A flat Gaussian that faces up, and probes that are open where `is_open`. The field is that of the probes.
    fn half_open(is_open: impl Fn(Vec3) -> bool) -> (Gaussians, Probes) {
        let directions = fibonacci_sphere(160);
        let transmittance = directions.iter().map(|d| vec![f32::from(is_open(*d))]).collect();
        let probes = Probes { hit: vec![vec![NO_HIT]; directions.len()], directions, transmittance };
        let mut g = Gaussians::zeroed(1, 1, DEGREE, 0);
        g.row_mut(Field::Quaternion, 0)[0] = 1.0;
        g.row_mut(Field::LogScale, 0).copy_from_slice(&[-2.0, -2.0, -5.0]);
        g.row_mut(Field::Visibility, 0).copy_from_slice(&probes.coefficients(DEGREE));
        (g, probes)
    }

    /// Irradiance of the Gaussian through the field, and with the shadows of the sky.
    fn irradiance(g: &Gaussians, probes: &Probes, sky: &EnvMap) -> (f32, f32) {
        let (options, tables) = (ShadingOptions::default(), rendering_tables(sky, DEGREE));
        let source = AttributeSource::new(g, &[[0.5; 3]], &options);
        let up = [[0.0, 0.0, 1.0]];
        let soft = through_visibility(&source, &tables, up[0], 0)[0];
        let shadows = SkyShadows::new(&source, probes, &up);
        (soft, soft + shadows.added_to(vec![[0.0; 6]], &source, &tables)[0][0])
    }

    /// A light of 12 degrees, 20 degrees beyond the edge of a shadow or before it.
    fn lamp(side: f64) -> EnvMap {
        let at = glam::DVec3::new(side * 0.34, 0.2, 0.9).normalize();
        EnvMap::from_fn(128, 64, |d| [if d.dot(at) > 0.978 { 40.0 } else { 0.0 }; 3])
    }

    #[test]
    fn shadow_of_a_lamp_has_the_edge_that_the_field_blurs() {
        let (g, probes) = half_open(|d| d[0] > 0.0);
        let (dark, light) = (irradiance(&g, &probes, &lamp(-1.0)), irradiance(&g, &probes, &lamp(1.0)));
        let (open, _) = half_open(|_| true);
        let (whole, _) = irradiance(&open, &probes, &lamp(1.0));
        assert!(dark.0 > 0.05 * whole, "the control: the field lets light through, {dark:?} of {whole}");
        assert!(dark.1.abs() < 0.4 * dark.0, "{dark:?}");
        assert!((light.1 - whole).abs() < 0.5 * (light.0 - whole).abs(), "{light:?} of {whole}");
    }

    #[test]
    fn even_sky_and_open_surfaces_need_no_difference() {
        let even = EnvMap::constant(32, 16, [1.0; 3]);
        let (g, probes) = half_open(|d| d[0] > 0.0);
        let (soft, sharp) = irradiance(&g, &probes, &even);
        assert!((sharp / soft - 1.0).abs() < 0.03, "{soft} {sharp}");
        let (g, probes) = half_open(|_| true);
        let (soft, sharp) = irradiance(&g, &probes, &lamp(1.0));
        assert!((sharp / soft - 1.0).abs() < 0.02, "{soft} {sharp}");
    }

    #[test]
    fn irradiance_is_never_negative() {
        let (mut g, probes) = half_open(|_| false);
        g.row_mut(Field::Visibility, 0).fill(0.4);
        let (soft, sharp) = irradiance(&g, &probes, &lamp(1.0));
        assert!(soft > 0.0, "the control: {soft}");
        assert!((0.0..1e-3 * soft).contains(&sharp), "{sharp}");
    }
}
