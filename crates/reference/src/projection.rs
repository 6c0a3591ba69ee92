//! Projection of Gaussians in space to ellipses on the image plane.

use glam::DVec3;

use super::array::Array;
use super::model::Parameters;
use super::ops::concat;
use super::tape::{Tape, Var};
use relume_scene::{Camera, Field};

/// Smallest depth at which a Gaussian is drawn, world units.
pub const NEAR: f64 = 0.05;

/// The Gaussians in front of the camera, front to back, on the image plane.
pub struct Splats<'t> {
    /// Their Gaussians, V indices.
    pub indices: Vec<usize>,
    /// Depths `z_c`, (V, 1).
    pub depths: Var<'t>,
    /// Projected centres, pixels, (V, 2).
    pub pixels: Var<'t>,
    /// Entries a, b, c of the inverse 2D covariance `[[a, b], [b, c]]`, 1/px^2, (V, 3).
    pub conics: Var<'t>,
    /// Factor on opacity that compensates for the low-pass, (V, 1).
    pub compensation: Var<'t>,
}

/// Rotation matrices of quaternions w x y z of any length, (N, 4) -> (N, 3, 3).
pub fn rotations(quaternions: Var<'_>) -> Var<'_> {
    let q = quaternions.normalised();
    let [w, x, y, z] = [0, 1, 2, 3].map(|i| q.column(i));
    let rows = [
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    ];
    let count = q.value().shape()[0];
    concat(q.tape, 1, &rows).reshaped(&[count, 3, 3])
}

/// Covariances `R S S R^T`, (N, 3, 3).
pub fn covariances<'t>(p: &Parameters<'t>) -> Var<'t> {
    let scales = p.get(Field::LogScale).exp();
    let count = scales.value().shape()[0];
    let m = rotations(p.get(Field::Quaternion)) * scales.reshaped(&[count, 1, 3]);
    m.matmul(m.transposed())
}

/// Projects every Gaussian in front of the camera with the local affine approximation of perspective, evaluated within the
/// `guard` band around the image only (docs/MODEL.md, section 2).
pub fn project<'t>(
    tape: &'t Tape,
    p: &Parameters<'t>,
    camera: &Camera,
    low_pass: f64,
    guard: GuardBand,
) -> Splats<'t> {
    let rotation = tape.input(Array::new(&[3, 3], camera.rotation.transpose().to_cols_array().to_vec()));
    let translation = tape.input(Array::new(&[3], camera.translation.to_array().to_vec()));
    let all = p.get(Field::Mean).matmul(rotation.transposed()) + translation;
    let is_shown = |i: usize| p.get(Field::SamplingRate).value().data()[i] >= 0.0;
    let indices = front_to_back(&all.value(), is_shown);
    let count = indices.len();

    let centres = all.gather(0, &indices);
    let [x, y, z] = [0, 1, 2].map(|i| centres.column(i));
    let pixels = concat(tape, 1, &[x / z * camera.fx + camera.cx, y / z * camera.fy + camera.cy]);
    let [slope_x, slope_y] = guard.limited(camera, x / z, y / z);
    let (zero, fx_z, fy_z) = (z * 0.0, camera.fx / z, camera.fy / z);
    let jacobian = [fx_z, zero, -fx_z * slope_x, zero, fy_z, -fy_z * slope_y];
    let jacobian = concat(tape, 1, &jacobian).reshaped(&[count, 2, 3]);

    let to_image = jacobian.matmul(rotation.reshaped(&[1, 3, 3]));
    let covariance = covariances(p).gather(0, &indices);
    let projected = to_image.matmul(covariance).matmul(to_image.transposed()).reshaped(&[count, 4]);
    let (a, b, c) = (projected.column(0), projected.column(1), projected.column(3));
    let sharp = a * c - b * b;
    let low_pass = low_passes(p, camera, (&indices, z), low_pass);
    let (a, c) = (a + low_pass, c + low_pass);
    let blurred = a * c - b * b;
    let conics = concat(tape, 1, &[c / blurred, -b / blurred, a / blurred]);
    let compensation = (sharp.at_least(0.0) / blurred).sqrt();
    Splats { indices, depths: z, pixels, conics, compensation }
}

/// The low-pass of each Gaussian, px^2, (V, 1), without gradient: 0.7 of that of the photograph that shows it largest, where this camera
/// shows it larger (docs/MODEL.md, section 2).
fn low_passes<'t>(
    p: &Parameters<'t>,
    camera: &Camera,
    (indices, depths): (&[usize], Var<'t>),
    low_pass: f64,
) -> Var<'t> {
    let rates = p.get(Field::SamplingRate).value();
    let depths = depths.value();
    let one = |(rate, depth): (f64, f64)| {
        let enlargement = (camera.fx * camera.fy).sqrt() / (depth * rate);
        if rate > 0.0 { low_pass * (0.7 * enlargement.powi(2)).max(1.0) } else { low_pass }
    };
    let rates = indices.iter().map(|i| rates.data()[*i]);
    let values = rates.zip(depths.data().iter().copied()).map(one).collect();
    p.get(Field::Mean).tape.input(Array::new(&[indices.len(), 1], values))
}

/// Region in which the affine approximation is evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GuardBand {
    /// Everywhere, as in the listing.
    Unlimited,
    /// Up to 15 % of the image's size outside of it.
    Image,
}

impl GuardBand {
    /// The ratios x/z and y/z at which the Jacobian is evaluated; a limited ratio passes no gradient.
    fn limited<'t>(self, camera: &Camera, x: Var<'t>, y: Var<'t>) -> [Var<'t>; 2] {
        let limit = |ratio: Var<'t>, size: u32, centre: f64, focal: f64| match self {
            Self::Unlimited => ratio,
            Self::Image => {
                let (size, margin) = (f64::from(size), 0.15 * f64::from(size));
                ratio.clamp((-centre - margin) / focal, (size - centre + margin) / focal)
            }
        };
        [limit(x, camera.width, camera.cx, camera.fx), limit(y, camera.height, camera.cy, camera.fy)]
    }
}

/// Indices of the centres beyond [`NEAR`] that are shown, nearest first; ties keep their order.
fn front_to_back(centres: &Array, is_shown: impl Fn(usize) -> bool) -> Vec<usize> {
    let depth = |i: &usize| centres.row(*i)[2];
    let mut indices: Vec<usize> =
        (0..centres.shape()[0]).filter(|i| depth(i) > NEAR && is_shown(*i)).collect();
    indices.sort_by(|i, j| depth(i).total_cmp(&depth(j)));
    indices
}

/// Pixel centres, row-major: x and y, each (P, 1).
pub fn pixel_centres<'t>(tape: &'t Tape, camera: &Camera) -> (Var<'t>, Var<'t>) {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let count = width * height;
    let x = (0..count).map(|i| (i % width) as f64 + 0.5).collect();
    let y = (0..count).map(|i| (i / width) as f64 + 0.5).collect();
    (tape.input(Array::new(&[count, 1], x)), tape.input(Array::new(&[count, 1], y)))
}

/// Unit vectors from the pixels to the camera, row-major, (P, 3).
pub fn view_vectors(camera: &Camera) -> Array {
    per_pixel(camera, |ray| -ray)
}

/// Directions from the camera through the pixels, `z_c = 1`, row-major, (P, 3).
pub fn rays(camera: &Camera) -> Array {
    per_pixel(camera, |ray| ray / ray.dot(camera.forward()))
}

fn per_pixel(camera: &Camera, f: impl Fn(DVec3) -> DVec3) -> Array {
    let pixels = (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (x, y)));
    Array::from_rows(&pixels.map(|(x, y)| f(camera.ray(x, y)).to_array()).collect::<Vec<_>>())
}
