//! Interreflection: the light that each Gaussian receives from the Gaussians that block its directions, under one light
//! (docs/MODEL.md, section 6).

use rayon::prelude::*;

use crate::cpu::attributes::AttributeSource;
use crate::cpu::probes::Probes;
use crate::sigmoid;
use relume_layout::constants::{MIN_BLOCKED_SHARE, NO_HIT};
use relume_scene::light::{LightTables, UNOCCLUDED_SH0};
use relume_scene::{Field, VisibilityForm};

type Vec3 = [f32; 3];

/// For each Gaussian, the Gaussians that block its directions; independent of the light.
#[derive(Debug, Clone)]
pub struct Transport {
    normals: Vec<Vec3>,
    /// First link of each Gaussian, and the end.
    first: Vec<u32>,
    links: Vec<Link>,
}

/// A direction in which a Gaussian is blocked.
#[derive(Debug, Clone, Copy)]
pub(super) struct Link {
    /// The blocking Gaussian.
    pub(super) from: u32,
    /// `(1 - V) (n . w)+ 4 pi / D`: the factor of its radiance in the irradiance.
    pub(super) irradiance: f32,
    /// `(1 - V)`, for the mean radiance over blocked directions of the upper hemisphere.
    pub(super) share: f32,
}

impl Transport {
    /// Links from measured probes; `normals` are the outward normals of the measurement.
    pub fn new(probes: &Probes, normals: Vec<Vec3>) -> Self {
        let weight = 4.0 * std::f32::consts::PI / probes.directions.len().max(1) as f32;
        let rows: Vec<Vec<Link>> = (0..normals.len())
            .into_par_iter()
            .with_min_len(256)
            .map(|i| {
                let mut row = Vec::new();
                for (k, d) in probes.directions.iter().enumerate() {
                    let facing = (0..3).map(|a| normals[i][a] * d[a]).sum::<f32>();
                    let (from, share) = (probes.hit[k][i], 1.0 - probes.transmittance[k][i]);
                    if facing <= 0.0 || from == NO_HIT || share < MIN_BLOCKED_SHARE {
                        continue;
                    }
                    // Only a face turned to the receiver emits towards it.
                    let emitter: f32 = (0..3).map(|a| normals[from as usize][a] * d[a]).sum();
                    let faces_receiver = if emitter < 0.0 { 1.0 } else { 0.0 };
                    row.push(Link { from, irradiance: faces_receiver * share * facing * weight, share });
                }
                row
            })
            .collect();
        let mut first = vec![0u32];
        let mut links = Vec::with_capacity(rows.iter().map(Vec::len).sum());
        for row in rows {
            links.extend(row);
            first.push(links.len() as u32);
        }
        Self { normals, first, links }
    }

    /// Gathered irradiance and mean blocked radiance per Gaussian after `bounces` rounds.
    pub fn gather(
        &self,
        source: &AttributeSource<'_>,
        tables: &LightTables,
        bounces: usize,
    ) -> Vec<[f32; 6]> {
        let n = self.normals.len();
        let diffuse = diffuse_reflectances(source);
        let from_sky = |i: usize| sky_irradiance(source, tables, self.normals[i], i);
        let direct: Vec<Vec3> = (0..n).into_par_iter().with_min_len(256).map(from_sky).collect();
        let mut gathered = vec![[0.0f32; 6]; n];
        for _ in 0..bounces {
            let emitted: Vec<Vec3> = (0..n)
                .map(|i| std::array::from_fn(|c| diffuse[i][c] * (direct[i][c] + gathered[i][c])))
                .collect();
            gathered =
                (0..n).into_par_iter().with_min_len(256).map(|i| self.gather_one(&emitted, i)).collect();
        }
        gathered
    }

    /// Outward normal of each Gaussian.
    pub(super) fn normals(&self) -> &[Vec3] {
        &self.normals
    }

    /// The links of Gaussian `i`.
    pub(super) fn links_of(&self, i: usize) -> &[Link] {
        &self.links[self.first[i] as usize..self.first[i + 1] as usize]
    }

    fn gather_one(&self, emitted: &[Vec3], i: usize) -> [f32; 6] {
        let mut out = [0.0f32; 6];
        let mut shares = 0.0;
        for link in self.links_of(i) {
            shares += link.share;
            if link.irradiance > 0.0 {
                let light = emitted[link.from as usize];
                (0..3).for_each(|c| out[c] += link.irradiance * light[c]);
                (0..3).for_each(|c| out[3 + c] += link.share * light[c]);
            }
        }
        if shares > 0.0 {
            out[3..].iter_mut().for_each(|v| *v /= shares);
        }
        out
    }
}

/// Radiance that each Gaussian reflects diffusely per irradiance: `albedo (1 - m) / pi`.
pub(super) fn diffuse_reflectances(source: &AttributeSource<'_>) -> Vec<Vec3> {
    let of = |i: usize| {
        let rest = 1.0 - sigmoid(source.gaussians.row(Field::MetalLogit, i)[0]);
        source.albedo(i).map(|a| a.clamp(0.0, 1.0) * rest * std::f32::consts::FRAC_1_PI)
    };
    (0..source.gaussians.len()).into_par_iter().with_min_len(256).map(of).collect()
}

/// Irradiance of Gaussian `i`, with outward unit normal `normal`: the sky through its visibility, plus the arriving shares of
/// the dominant lights.
pub fn sky_irradiance(source: &AttributeSource<'_>, tables: &LightTables, normal: Vec3, i: usize) -> Vec3 {
    let mut out = through_visibility(source, tables, normal, i);
    for (light, arriving) in tables.lights.iter().zip(source.arriving_at(i)) {
        let cos: f32 = (0..3).map(|k| normal[k] * light.direction[k]).sum();
        if cos > 0.0 {
            (0..3).for_each(|c| out[c] += arriving * cos * light.irradiance[c]);
        }
    }
    out
}

/// Irradiance of Gaussian `i`, with unit normal `normal`, by the sky through its visibility.
pub(super) fn through_visibility(
    source: &AttributeSource<'_>,
    tables: &LightTables,
    normal: Vec3,
    i: usize,
) -> Vec3 {
    let taps = tables.diffuse_grid.lookup(normal);
    let c = source.gaussians.row(Field::Visibility, i);
    let open = source.options.visibility == VisibilityForm::Off;
    let mut out = [0.0f32; 3];
    for k in 0..4 {
        for (o, row) in out.iter_mut().zip(tables.diffuse_rows(taps.node[k])) {
            let e: f32 =
                if open { row[0] * UNOCCLUDED_SH0 } else { row.iter().zip(c).map(|(t, c)| t * c).sum() };
            *o += taps.weight[k] * e;
        }
    }
    out.map(|e| e.max(0.0))
}
