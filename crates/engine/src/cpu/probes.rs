//! Transmittance probes: the visibility of the environment from each Gaussian, and its dominant occluder (docs/MODEL.md,
//! section 6).
//!
//! Directions are independent and run in parallel; `shadows.rs` answers all queries of one direction.

use rayon::prelude::*;

use crate::cpu::attributes::AttributeSource;
use crate::cpu::occluder::{Vec3, dot, occluders};
use crate::cpu::project::rotation;
use crate::cpu::shadows::{VisibilityQuery, measure_direction};
use crate::{ProbeSettings, towards_light};
use relume_scene::light::sh_eval;
use relume_scene::{Field, MAX_LIGHTS, SplitLight, VisibilityForm, sh_count};

/// Measured visibility of a set of Gaussians.
#[derive(Debug, Clone)]
pub struct Probes {
    /// Unit directions.
    pub directions: Vec<Vec3>,
    /// `[direction][member]`: transmittance towards the direction.
    pub transmittance: Vec<Vec<f32>>,
    /// `[direction][member]`: the Gaussian that blocks most of the rest, or [`NO_HIT`](relume_layout::constants::NO_HIT).
    pub hit: Vec<Vec<u32>>,
}

/// Share of each light that arrives at each of the Gaussians `members`, `[light][member]`, 0..=1: the mean transmittance over the
/// light's disc, and 1 where the visibility form is `Off`.
pub fn light_shares(source: &AttributeSource<'_>, lights: &[SplitLight], members: &[u32]) -> Vec<Vec<f32>> {
    let count = members.len();
    if source.options.visibility == VisibilityForm::Off {
        return vec![vec![1.0; count]; lights.len()];
    }
    let towards: Vec<Vec<Vec3>> = lights.iter().map(towards_light).collect();
    let settings = ProbeSettings::of(source.options);
    let measured = Probes::measure_from(source, members, towards.concat(), settings).transmittance;
    let mut rest = measured.as_slice();
    let mean = |directions: &Vec<Vec3>| {
        let (of_light, others) = rest.split_at(directions.len());
        rest = others;
        let weight = 1.0 / directions.len() as f32;
        let at = |i: usize| (of_light.iter().map(|t| t[i]).sum::<f32>() * weight).clamp(0.0, 1.0);
        (0..count).map(at).collect()
    };
    towards.iter().map(mean).collect()
}

/// Share of each light that arrives at every Gaussian, as in [`AttributeSource::arriving`]: empty without lights, and where
/// the visibility form is `Off`.
pub fn arriving(source: &AttributeSource<'_>, lights: &[SplitLight]) -> Vec<[f32; MAX_LIGHTS]> {
    if lights.is_empty() || source.options.visibility == VisibilityForm::Off {
        return Vec::new();
    }
    let shares = light_shares(source, lights, &all(source));
    let share = |k: usize, i: usize| shares.get(k).map_or(1.0, |of_light| of_light[i]);
    (0..source.gaussians.len()).map(|i| std::array::from_fn(|k| share(k, i))).collect()
}

/// The indices of all Gaussians.
fn all(source: &AttributeSource<'_>) -> Vec<u32> {
    (0..source.gaussians.len()).map(|i| i as u32).collect()
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
    /// Measures `directions` from every Gaussian of `source`, from its centre moved outwards by `settings`.
    pub fn measure(source: &AttributeSource<'_>, directions: Vec<Vec3>, settings: ProbeSettings) -> Self {
        Self::measure_from(source, &all(source), directions, settings)
    }

    /// Measures `directions` from the Gaussians `members` of `source` alone.
    fn measure_from(
        source: &AttributeSource<'_>,
        members: &[u32],
        directions: Vec<Vec3>,
        settings: ProbeSettings,
    ) -> Self {
        let occluders = occluders(source);
        let normals = outward_normals(source);
        let queries: Vec<VisibilityQuery> = members
            .iter()
            .map(|member| {
                let (o, n) = (&occluders[*member as usize], &normals[*member as usize]);
                let sigma = o.axes.iter().map(|a| dot(*a, *n).powi(2)).sum::<f32>().sqrt();
                let point =
                    std::array::from_fn(|k| o.mean[k] + (settings.offset * sigma + settings.lift) * n[k]);
                VisibilityQuery { gaussian: *member, point, clearance: sigma + settings.bias }
            })
            .collect();
        let measured: Vec<(Vec<f32>, Vec<u32>)> =
            directions.par_iter().map(|d| measure_direction(&occluders, &queries, *d, settings)).collect();
        let (transmittance, hit) = measured.into_iter().unzip();
        Self { directions, transmittance, hit }
    }

    /// Visibility coefficients of degree `sh_degree`, `[Gaussian][coefficient]`: `4 pi / D sum_d V Y`.
    pub fn coefficients(&self, sh_degree: usize) -> Vec<f32> {
        let n = sh_count(sh_degree);
        let weight = 4.0 * std::f32::consts::PI / self.directions.len().max(1) as f32;
        let basis: Vec<[f32; 64]> = self
            .directions
            .iter()
            .map(|d| {
                let mut y = [0.0f32; 64];
                sh_eval(sh_degree, *d, &mut y);
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
