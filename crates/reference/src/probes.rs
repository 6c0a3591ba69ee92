//! Measured visibility and gathered light (docs/MODEL.md, section 6), from every pair of Gaussians in every direction.
//! Measurements are constants: plain f64, no tape.

use std::f64::consts::PI;

use glam::{DMat3, DVec3};

use super::array::Array;
use super::compositing::AlphaLimits;
use super::model::{Parameters, ReferenceModel};
use super::projection::covariances;
use super::spherical::real_sh;
use super::tape::Tape;
use relume_scene::Field;

/// Measurement of N Gaussians in D directions.
#[derive(Debug, Clone, PartialEq)]
pub struct Probes {
    /// The unit directions, (D, 3).
    pub directions: Array,
    /// Transmittance to infinity, (N, D).
    pub transmittance: Array,
    /// Weight `T_j a_j` of each Gaussian seen, (N, D, N).
    pub seen: Array,
}

/// A Gaussian as an occluder.
struct Occluder {
    mean: DVec3,
    covariance: DMat3,
    opacity: f64,
}

impl Occluder {
    /// Standard deviation along `d`.
    fn sigma(&self, d: DVec3) -> f64 {
        d.dot(self.covariance * d).max(0.0).sqrt()
    }

    /// Alpha at `point` in orthographic projection along `d`.
    fn alpha(&self, point: DVec3, d: DVec3, limits: AlphaLimits) -> f64 {
        let (u, v) = d.any_orthonormal_pair();
        let [uu, uv, vv] = [(u, u), (u, v), (v, v)].map(|(a, b)| a.dot(self.covariance * b));
        // Without the widening a disc seen edge-on would have width 0.
        let widening = 1e-4 * (uu + vv) + 1e-14;
        let (uu, vv) = (uu + widening, vv + widening);
        let away = point - self.mean;
        let (x, y) = (away.dot(u), away.dot(v));
        let power = -0.5 * (vv * x * x - 2.0 * uv * x * y + uu * y * y) / (uu * vv - uv * uv);
        let alpha = (self.opacity * power.min(0.0).exp()).min(limits.largest);
        if alpha > limits.cutoff { alpha } else { 0.0 }
    }
}

impl Probes {
    /// Measures `directions` (D, 3) from each centre, moved `offset` standard deviations along its normal (N, 3). A Gaussian
    /// within one standard deviation of both along the direction does not occlude.
    pub fn measure(scene: &ReferenceModel, normals: &Array, directions: &Array, offset: f64) -> Self {
        let occluders = occluders(scene);
        let (count, rays) = (occluders.len(), directions.shape()[0]);
        let mut transmittance = Array::filled(&[count, rays], 1.0);
        let mut seen = Array::zeros(&[count, rays, count]);
        for (i, own) in occluders.iter().enumerate() {
            let normal = DVec3::from_slice(normals.row(i));
            let clearance = own.sigma(normal);
            let from = own.mean + offset * clearance * normal;
            for k in 0..rays {
                let d = DVec3::from_slice(directions.row(k));
                let mut ahead: Vec<(f64, usize)> = (0..count)
                    .map(|j| ((occluders[j].mean - from).dot(d), j))
                    .filter(|&(depth, j)| j != i && depth >= occluders[j].sigma(d) + clearance)
                    .collect();
                ahead.sort_by(|a, b| a.0.total_cmp(&b.0));
                let left = &mut transmittance.data_mut()[i * rays + k];
                for (_, j) in ahead {
                    let alpha = occluders[j].alpha(from, d, AlphaLimits::default());
                    seen.data_mut()[(i * rays + k) * count + j] = *left * alpha;
                    *left *= 1.0 - alpha;
                }
            }
        }
        Self { directions: directions.clone(), transmittance, seen }
    }

    /// Visibility coefficients `4 pi / D sum_d V(w_d) Y(w_d)` up to degree `sh_degree`, (N, (degree + 1)^2).
    pub fn coefficients(&self, sh_degree: usize) -> Array {
        let tape = Tape::new();
        let basis = real_sh(tape.input(self.directions.clone()), sh_degree);
        let share = 4.0 * PI / self.directions.shape()[0] as f64;
        (*(tape.input(self.transmittance.clone()).matmul(basis) * share).value()).clone()
    }

    /// Irradiance `4 pi / D sum_d (n . w_d)+ sum_j T_j a_j B_j` at unit normals (N, 3) from the radiances B (N, 3)
    /// of the faces turned to the receiver, (N, 3).
    pub fn gathered_irradiance(&self, normals: &Array, radiances: &Array) -> Array {
        let [count, rays] = [0, 1].map(|i| self.transmittance.shape()[i]);
        let normal = |i: usize| DVec3::from_slice(normals.row(i));
        let mut out = vec![DVec3::ZERO; count];
        for (i, sum) in out.iter_mut().enumerate() {
            for k in 0..rays {
                let d = DVec3::from_slice(self.directions.row(k));
                let share = 4.0 * PI / rays as f64 * normal(i).dot(d).max(0.0);
                let turned = (0..count).filter(|&j| normal(j).dot(d) < 0.0);
                let light = |j: usize| self.seen.row(i * rays + k)[j] * DVec3::from_slice(radiances.row(j));
                *sum += share * turned.map(light).sum::<DVec3>();
            }
        }
        Array::from_rows(&out.iter().map(DVec3::to_array).collect::<Vec<_>>())
    }
}

fn occluders(scene: &ReferenceModel) -> Vec<Occluder> {
    let tape = Tape::new();
    let p = Parameters::new(&tape, scene);
    let covariances = covariances(&p).value();
    let opacities = p.get(Field::OpacityLogit).sigmoid().value();
    let means = scene.array(Field::Mean.name());
    let occluder = |i: usize| Occluder {
        mean: DVec3::from_slice(means.row(i)),
        covariance: DMat3::from_cols_slice(&covariances.data()[9 * i..9 * i + 9]),
        opacity: opacities.data()[i],
    };
    (0..means.shape()[0]).map(occluder).collect()
}
