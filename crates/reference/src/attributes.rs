//! Attributes of each Gaussian in the G-buffer: activations of raw parameters (docs/MODEL.md, section 1).

use super::array::Array;
use super::model::Parameters;
use super::projection::rotations;
use super::spherical::{real_sh, sh_degree_of};
use super::tape::{Tape, Var};
use relume_scene::{Camera, Field, NormalForm};

/// Vectors from the camera's centre to the Gaussians, (N, 3).
pub fn from_camera<'t>(tape: &'t Tape, p: &Parameters<'t>, camera: &Camera) -> Var<'t> {
    p.get(Field::Mean) - tape.input(Array::from_rows(&[camera.centre().to_array()]))
}

/// Unit normals, (N, 3).
pub fn normals<'t>(tape: &'t Tape, p: &Parameters<'t>, camera: &Camera, form: NormalForm) -> Var<'t> {
    let raw = p.get(Field::Normal);
    match form {
        NormalForm::Free => raw.normalised(),
        NormalForm::ShortestAxis => (shortest_axes(p, from_camera(tape, p, camera)) + raw).normalised(),
    }
}

/// The axis of smallest scale, turned against `outward`, (N, 3). The choice of axis and side is discrete, so it has no
/// gradient.
fn shortest_axes<'t>(p: &Parameters<'t>, outward: Var<'t>) -> Var<'t> {
    let smallest = p.get(Field::LogScale).value().smallest_columns();
    let columns: Vec<usize> = smallest.iter().enumerate().map(|(i, column)| 3 * i + column).collect();
    let count = columns.len();
    let axes = rotations(p.get(Field::Quaternion)).transposed().reshaped(&[3 * count, 3]);
    let axes = axes.gather(0, &columns);
    let side = axes.dot(outward).value().map(|along| if along > 0.0 { -1.0 } else { 1.0 });
    axes * axes.tape.input(side)
}

/// Colour of the radiance branch, display-referred, (N, 3).
pub fn radiance<'t>(tape: &'t Tape, p: &Parameters<'t>, camera: &Camera) -> Var<'t> {
    let raw = p.get(Field::Radiance);
    let (count, floats) = (raw.value().shape()[0], raw.value().shape()[1]);
    let coefficients = raw.reshaped(&[count, floats / 3, 3]);
    let sh_degree = (floats / 3).isqrt() - 1;
    let basis = real_sh(from_camera(tape, p, camera).normalised(), sh_degree);
    let colour = (coefficients * basis.reshaped(&[count, floats / 3, 1])).sum_axis(1);
    (colour.reshaped(&[count, 3]) + 0.5).at_least(0.0)
}

/// Visibility `sum c Y(d)` of coefficients (n, (L + 1)^2) along unit directions (n, 3), unsquashed, (n, 1).
pub fn field<'t>(coefficients: Var<'t>, directions: Var<'t>) -> Var<'t> {
    coefficients.dot(real_sh(directions, sh_degree_of(coefficients)))
}
