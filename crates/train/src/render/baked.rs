//! Bakes a model under one light to colour, for splat programs without materials.

use rayon::prelude::*;

use crate::render::renderer::{PreparedLight, Renderer};
use relume_engine::{HostLight, fibonacci_sphere};
use relume_scene::light::sh_eval;
use relume_scene::{Field, Model, VisibilityForm, sh_count};
use relume_spec::rendering::MAX_BAKED_DEGREE;

const MAX_COEFFICIENTS: usize = sh_count(MAX_BAKED_DEGREE);
/// Number of directions in which each Gaussian is shaded.
const DIRECTIONS: usize = 192;
/// Weight of a direction in which a Gaussian is occluded, so that the fit stays determined.
const MIN_WEIGHT: f64 = 0.02;

impl Renderer {
    /// The model with a radiance branch that shows it under `light`. For each Gaussian, the SH of `degree` (at most
    /// [`MAX_BAKED_DEGREE`]) approximate its sRGB-encoded shaded colour by least squares over the directions from
    /// which it is visible.
    pub fn baked(&self, light: &PreparedLight, degree: usize) -> Model {
        let degree = degree.min(MAX_BAKED_DEGREE);
        let (model, light) = (self.model(), self.light_on_host(light));
        let directions = fibonacci_sphere(DIRECTIONS);
        let count = sh_count(degree);
        let mut coefficients = vec![0.0f32; model.gaussians.len() * 3 * count];
        coefficients.par_chunks_mut(3 * count).enumerate().with_min_len(64).for_each(|(i, out)| {
            fit(model, light, i, &directions, degree, out);
        });
        Model { gaussians: model.gaussians.clone().with_radiance(degree, coefficients), ..model.clone() }
    }
}

/// Weighted least squares for Gaussian `i`.
fn fit(model: &Model, light: &HostLight, i: usize, directions: &[[f32; 3]], degree: usize, out: &mut [f32]) {
    let count = sh_count(degree);
    let (mut matrix, mut right) =
        ([[0.0f64; MAX_COEFFICIENTS]; MAX_COEFFICIENTS], [[0.0f64; 3]; MAX_COEFFICIENTS]);
    for along in directions {
        let sent = light.outgoing(i, *along).total();
        let shown = sent.map(|c| f64::from(relume_scene::srgb::encode(c)) - 0.5);
        let weight = seen_from(model, i, along.map(|a| -a)).max(MIN_WEIGHT);
        let mut y = [0.0f64; MAX_COEFFICIENTS];
        sh_eval(degree, along.map(f64::from), &mut y);
        for j in 0..count {
            (0..=j).for_each(|k| matrix[j][k] += weight * y[j] * y[k]);
            (0..3).for_each(|c| right[j][c] += weight * y[j] * shown[c]);
        }
    }
    solve(&mut matrix, &mut right, count);
    out.as_chunks_mut::<3>().0.iter_mut().zip(&right).for_each(|(o, r)| *o = r.map(|v| v as f32));
}

/// Visibility of Gaussian `i` in `direction`, 0 to 1.
fn seen_from(model: &Model, i: usize, direction: [f32; 3]) -> f64 {
    let Model { gaussians, shading, .. } = model;
    if shading.visibility == VisibilityForm::Off {
        return 1.0;
    }
    let coefficients = gaussians.row(Field::Visibility, i);
    let mut y = [0.0f32; 81];
    sh_eval(gaussians.visibility_degree(), direction, &mut y);
    let raw: f32 = coefficients.iter().zip(y).map(|(c, y)| c * y).sum();
    f64::from(match shading.visibility {
        VisibilityForm::Sigmoid => 1.0 / (1.0 + (-raw).exp()),
        _ => raw.clamp(0.0, 1.0),
    })
}

/// Solves `matrix x = right` for the first `count` unknowns, by Cholesky's method, and writes the solution to
/// `right`. Reads the lower triangle of a symmetric positive definite `matrix`.
fn solve(
    matrix: &mut [[f64; MAX_COEFFICIENTS]; MAX_COEFFICIENTS],
    right: &mut [[f64; 3]; MAX_COEFFICIENTS],
    count: usize,
) {
    for j in 0..count {
        for k in 0..=j {
            let below: f64 = (0..k).map(|n| matrix[j][n] * matrix[k][n]).sum();
            let rest = matrix[j][k] - below;
            matrix[j][k] = if j == k { rest.max(1e-12).sqrt() } else { rest / matrix[k][k] };
        }
    }
    for c in 0..3 {
        for j in 0..count {
            let known: f64 = (0..j).map(|k| matrix[j][k] * right[k][c]).sum();
            right[j][c] = (right[j][c] - known) / matrix[j][j];
        }
        for j in (0..count).rev() {
            let known: f64 = (j + 1..count).map(|k| matrix[k][j] * right[k][c]).sum();
            right[j][c] = (right[j][c] - known) / matrix[j][j];
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use relume_compare::{largest_difference, worst};
    use relume_engine::srgb;
    use relume_scene::{EnvMap, Gaussians, IndirectForm, ShadingOptions};

    /// One flat Gaussian of a reddish dielectric, unoccluded.
    fn model() -> Model {
        let mut g = Gaussians::zeroed(1, 1, 1, 0);
        g.row_mut(Field::LogScale, 0).copy_from_slice(&[-2.0, -2.0, -5.0]);
        g.row_mut(Field::Quaternion, 0)[0] = 1.0;
        g.row_mut(Field::Residual, 0).copy_from_slice(&[0.5, 0.2, 0.1]);
        g.row_mut(Field::MetalLogit, 0)[0] = -5.0;
        g.row_mut(Field::RoughLogit, 0)[0] = 1.0;
        let off = (VisibilityForm::Off, IndirectForm::Off);
        let shading = ShadingOptions { visibility: off.0, indirect: off.1, ..ShadingOptions::default() };
        Model { shading, ..Model::new(g, vec![[0.0; 3]], vec![[0.0; 3]; 2], (2, 1)) }
    }

    /// Largest difference between the baked colour under a uniform light of radiance `baked` and the shaded colour
    /// under one of radiance `shaded`.
    fn baking_error(baked: f32, shaded: f32) -> f64 {
        let renderer = Renderer::new(Arc::new(model()));
        let light = |level: f32| renderer.prepare_light(EnvMap::constant(16, 8, [level; 3])).unwrap();
        let model = renderer.baked(&light(baked), MAX_BAKED_DEGREE);
        let light = light(shaded);
        let (host, coefficients) = (renderer.light_on_host(&light), model.gaussians.row(Field::Radiance, 0));
        let differs = |along: [f32; 3]| {
            let sent = host.outgoing(0, along).total();
            let mut y = [0.0f32; MAX_COEFFICIENTS];
            sh_eval(MAX_BAKED_DEGREE, along, &mut y);
            let shown: [f32; 3] = std::array::from_fn(|c| {
                0.5 + (0..MAX_COEFFICIENTS).map(|j| coefficients[3 * j + c] * y[j]).sum::<f32>()
            });
            largest_difference(&shown, &sent.map(|v| srgb(v.clamp(0.0, 1.0))))
        };
        let directions = [[0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [0.48, 0.64, 0.6]];
        worst(directions.into_iter().map(differs))
    }

    #[test]
    fn baked_colour_matches_the_shaded_colour() {
        assert!(baking_error(0.7, 0.7) < 0.03, "{}", baking_error(0.7, 0.7));
        let control = baking_error(0.7, 0.35);
        assert!(control.is_finite() && control > 0.1, "the control: {control}");
    }

    #[test]
    fn symmetric_linear_system_is_solved() {
        let (mut matrix, mut right) =
            ([[0.0; MAX_COEFFICIENTS]; MAX_COEFFICIENTS], [[0.0; 3]; MAX_COEFFICIENTS]);
        let rows = [[4.0, 1.0, 0.5], [1.0, 3.0, -1.0], [0.5, -1.0, 2.0]];
        let wanted = [[1.0, 0.0, 0.0], [-2.0, 0.0, 0.6], [3.0, 0.0, 0.8]];
        for j in 0..3 {
            matrix[j][..3].copy_from_slice(&rows[j]);
            right[j] = std::array::from_fn(|c| (0..3).map(|k| rows[j][k] * wanted[k][c]).sum());
        }
        solve(&mut matrix, &mut right, 3);
        for (found, wanted) in right.iter().zip(wanted) {
            assert!(found.iter().zip(wanted).all(|(f, w)| (f - w).abs() < 1e-12), "{found:?}");
        }
    }
}
