//! Projection of one Gaussian to a screen-space splat, forward and backward (docs/MODEL.md, section 2).
//!
//! The determinant of the screen covariance `M M^T` is computed as the squared length of the cross product of M's rows: for
//! needles `xx yy - xy^2` would be the difference of two large numbers. The low-pass l, added to xx and yy, adds
//! `l (xx + yy) + l^2`, a sum of positive terms.

use crate::{RasterCamera, sigmoid, sigmoid_derivative};
use relume_layout::constants::{
    ALPHA_MIN, FAR, LOG_SCALE_LIMIT, MAX_PIXEL_DISTANCE, MAX_SCREEN_VARIANCE, MIN_DETERMINANT, NEAR,
};

/// A projected Gaussian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Splat {
    /// Index of the Gaussian in the model.
    pub gaussian: u32,
    /// Projected mean, pixels.
    pub mean: [f32; 2],
    /// Inverse of the screen covariance: `xx, xy, yy`.
    pub conic: [f32; 3],
    /// Screen covariance, low-pass included: `xx, xy, yy`, px^2.
    pub covariance: [f32; 3],
    /// Opacity, compensation included.
    pub opacity: f32,
    /// Factor by which the compensation multiplied the opacity (1 without compensation).
    pub compensation: f32,
    /// `ln(255 opacity)`: at a larger exponent alpha is below 1/255.
    pub reach: f32,
    /// Camera depth.
    pub depth: f32,
    /// Key with the order of depth, see [`RasterCamera::depth_key`].
    pub depth_key: u32,
}

/// Raw geometry of one Gaussian.
#[derive(Debug, Clone, Copy)]
pub struct Geometry {
    /// Centre.
    pub mean: [f32; 3],
    /// ln of the standard deviations.
    pub log_scale: [f32; 3],
    /// Quaternion w x y z, any length.
    pub quaternion: [f32; 4],
    /// Opacity logit.
    pub opacity_logit: f32,
    /// Pixels per unit of length in the photograph that shows the Gaussian largest; 0 if unknown, negative if none shows it.
    pub sampling_rate: f32,
}

/// Gradient of a splat from the blending's backward pass.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SplatGradient {
    /// Gradient by projected mean, per pixel.
    pub mean: [f32; 2],
    /// Gradient by conic `xx, xy, yy`.
    pub conic: [f32; 3],
    /// Gradient by effective opacity.
    pub opacity: f32,
}

/// Gradient of [`Geometry`].
#[derive(Debug, Clone, Copy, Default)]
pub struct GeometryGradient {
    /// Gradient by centre.
    pub mean: [f32; 3],
    /// Gradient by ln scale.
    pub log_scale: [f32; 3],
    /// Gradient by rotation matrix, row-major. The chain rule to the quaternion runs once, after all terms of the matrix.
    pub rotation: [[f32; 3]; 3],
    /// Gradient by opacity logit.
    pub opacity_logit: f32,
}

type Mat3 = [[f32; 3]; 3];

/// `v / max(|v|, 1e-12)` and the length used.
#[inline]
pub fn normalise<const N: usize>(v: [f32; N]) -> ([f32; N], f32) {
    // f64 inside: squares of small components would underflow f32.
    let length = v.iter().map(|x| f64::from(*x) * f64::from(*x)).sum::<f64>().sqrt().max(1e-12);
    let inverse = 1.0 / length;
    (v.map(|x| (f64::from(x) * inverse) as f32), length as f32)
}

/// Gradient through `v / |v|`, given the unit vector and the length.
#[inline]
pub fn normalise_backward<const N: usize>(unit: [f32; N], length: f32, gradient: [f32; N]) -> [f32; N] {
    let radial: f32 = (0..N).map(|k| unit[k] * gradient[k]).sum();
    std::array::from_fn(|k| (gradient[k] - radial * unit[k]) / length)
}

/// Rotation matrix (row-major) of a quaternion of any length; zero length is the identity.
pub fn rotation(quaternion: [f32; 4]) -> Mat3 {
    let ([w, x, y, z], length) = normalise(quaternion);
    if length <= 1e-12 {
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    }
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// Gradient of the raw quaternion from that of the rotation matrix.
pub fn rotation_backward(quaternion: [f32; 4], g: &Mat3) -> [f32; 4] {
    let (unit, length) = normalise(quaternion);
    if length <= 1e-12 {
        return [0.0; 4];
    }
    let [w, x, y, z] = unit;
    let by_unit = [
        2.0 * (x * (g[2][1] - g[1][2]) + y * (g[0][2] - g[2][0]) + z * (g[1][0] - g[0][1])),
        2.0 * (y * (g[0][1] + g[1][0]) + z * (g[0][2] + g[2][0]) + w * (g[2][1] - g[1][2])
            - 2.0 * x * (g[1][1] + g[2][2])),
        2.0 * (x * (g[0][1] + g[1][0]) + z * (g[1][2] + g[2][1]) + w * (g[0][2] - g[2][0])
            - 2.0 * y * (g[0][0] + g[2][2])),
        2.0 * (x * (g[0][2] + g[2][0]) + y * (g[1][2] + g[2][1]) + w * (g[1][0] - g[0][1])
            - 2.0 * z * (g[0][0] + g[1][1])),
    ];
    normalise_backward(unit, length, by_unit)
}

impl Geometry {
    /// True when no parameter is NaN. Scales and opacity may be infinite: they are clamped.
    pub(super) fn is_usable(&self) -> bool {
        let finite = self.mean.iter().chain(&self.quaternion).all(|v| v.is_finite());
        finite && !self.opacity_logit.is_nan() && !self.log_scale.iter().any(|s| s.is_nan())
    }
}

/// Values that forward and backward share.
struct Projection {
    /// Camera-space mean.
    camera: [f32; 3],
    /// `J R`, 2 x 3.
    to_screen: [[f32; 3]; 2],
    /// Clamped `x/z`, `y/z` and whether each was inside.
    ratio: [(f32, bool); 2],
    /// `Q S`, columns are the scaled axes.
    axes: Mat3,
    scale: [f32; 3],
    /// The three scaled axes on screen, 2 x 3. Sums of their squares cannot become negative.
    screen: [[f32; 3]; 2],
    /// Screen covariance without the low-pass.
    raw: [f32; 3],
    /// Its determinant.
    raw_determinant: f32,
    /// Cross product of the rows of `screen`.
    area: [f32; 3],
    /// Low-pass of this Gaussian, px^2.
    low_pass: f32,
}

fn prepare(view: &RasterCamera, g: &Geometry) -> Option<Projection> {
    if !g.is_usable() || g.sampling_rate < 0.0 {
        return None;
    }
    let camera = view.to_camera(g.mean);
    // Written so that NaN fails.
    if !(camera[2] > NEAR && camera[2] < FAR) {
        return None;
    }
    let inverse = 1.0 / camera[2];
    let ratio = std::array::from_fn(|k| {
        let r = camera[k] * inverse;
        let [lo, hi] = view.ratio_limits[k];
        (r.clamp(lo, hi), r > lo && r < hi)
    });
    let jacobian = [
        [view.focal[0] * inverse, 0.0, -view.focal[0] * ratio[0].0 * inverse],
        [0.0, view.focal[1] * inverse, -view.focal[1] * ratio[1].0 * inverse],
    ];
    let to_screen = std::array::from_fn(|r| {
        std::array::from_fn(|c| (0..3).map(|k| jacobian[r][k] * view.rotation[k][c]).sum())
    });
    let rotation = rotation(g.quaternion);
    let scale = g.log_scale.map(|s| s.clamp(-LOG_SCALE_LIMIT, LOG_SCALE_LIMIT).exp());
    let axes: Mat3 = std::array::from_fn(|r| std::array::from_fn(|c| rotation[r][c] * scale[c]));
    // The scale is applied last, so that axes of different length do not cancel.
    let screen: [[f32; 3]; 2] = std::array::from_fn(|r| {
        std::array::from_fn(|c| scale[c] * (0..3).map(|k| to_screen[r][k] * rotation[k][c]).sum::<f32>())
    });
    let dot = |a: &[f32; 3], b: &[f32; 3]| (0..3).map(|k| a[k] * b[k]).sum::<f32>();
    let raw = [dot(&screen[0], &screen[0]), dot(&screen[0], &screen[1]), dot(&screen[1], &screen[1])];
    if !(raw[0] < MAX_SCREEN_VARIANCE && raw[2] < MAX_SCREEN_VARIANCE) {
        return None;
    }
    let area = cross(&screen[0], &screen[1]);
    let raw_determinant = dot(&area, &area);
    let low_pass = view.low_pass_of(camera[2], g.sampling_rate);
    Some(Projection { camera, to_screen, ratio, axes, scale, screen, raw, raw_determinant, area, low_pass })
}

/// Projects a Gaussian, or `None` when no pixel can see it.
pub fn project(view: &RasterCamera, index: u32, g: &Geometry) -> Option<Splat> {
    let p = prepare(view, g)?;
    let (raw, raw_determinant, low_pass) = (p.raw, p.raw_determinant, p.low_pass);
    let covariance = [raw[0] + low_pass, raw[1], raw[2] + low_pass];
    let determinant = blurred_determinant(&p);
    if !(determinant > MIN_DETERMINANT) {
        return None;
    }
    let conic = [covariance[2], -covariance[1], covariance[0]].map(|v| v / determinant);
    let compensation = if view.low_pass_compensation { (raw_determinant / determinant).sqrt() } else { 1.0 };
    let opacity = sigmoid(g.opacity_logit) * compensation;
    if !(opacity >= ALPHA_MIN) {
        return None;
    }
    let mean: [f32; 2] =
        std::array::from_fn(|k| view.focal[k] * (p.camera[k] / p.camera[2]) + view.centre_px[k]);
    // A mean beyond this distance reaches no pixel, and the backward pass would overflow.
    if !(mean[0].abs() < MAX_PIXEL_DISTANCE && mean[1].abs() < MAX_PIXEL_DISTANCE) {
        return None;
    }
    let reach = (255.0 * opacity).ln();
    let depth = p.camera[2];
    Some(Splat {
        gaussian: index,
        mean,
        conic,
        covariance,
        opacity,
        compensation,
        reach,
        depth,
        depth_key: view.depth_key(g.mean),
    })
}

fn cross(a: &[f32; 3], b: &[f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Determinant of the screen covariance, low-pass included.
fn blurred_determinant(p: &Projection) -> f32 {
    let low_pass = p.low_pass;
    p.raw_determinant + low_pass * (p.raw[0] + p.raw[2]) + low_pass * low_pass
}

/// Chain rule from a splat's gradient to the Gaussian's geometry; `s` is the forward result.
pub fn project_backward(view: &RasterCamera, g: &Geometry, s: &Splat, d: &SplatGradient) -> GeometryGradient {
    let Some(p) = prepare(view, g) else { return GeometryGradient::default() };
    let mut out = GeometryGradient::default();
    let sigma = sigmoid(g.opacity_logit);
    out.opacity_logit = d.opacity * s.compensation * sigmoid_derivative(g.opacity_logit);
    // Gradient by the conic as a symmetric matrix.
    let (da, db, dc) = (d.conic[0], 0.5 * d.conic[1], d.conic[2]);
    let by_screen = screen_backward(view, &p, s, [da, db, dc], d.opacity * sigma, &mut out.log_scale);
    // M = Q S, screen = T M.
    for row in 0..3 {
        for k in 0..3 {
            let by_axis = p.to_screen[0][row] * by_screen[0][k] + p.to_screen[1][row] * by_screen[1][k];
            out.rotation[row][k] = by_axis * p.scale[k];
        }
    }
    // T = J R.
    let by_t: [[f32; 3]; 2] = std::array::from_fn(|r| {
        std::array::from_fn(|j| (0..3).map(|k| by_screen[r][k] * p.axes[j][k]).sum())
    });
    let by_j = |r: usize, k: usize| (0..3).map(|c| by_t[r][c] * view.rotation[k][c]).sum::<f32>();
    let inverse = 1.0 / p.camera[2];
    let mut camera = [0.0f32; 3];
    for k in 0..2 {
        let f = view.focal[k];
        let (diagonal, slanted) = (by_j(k, k), by_j(k, 2));
        let (ratio, inside) = p.ratio[k];
        camera[2] += inverse * inverse * f * (slanted * ratio - diagonal);
        let by_ratio = f * d.mean[k] + if inside { -f * inverse * slanted } else { 0.0 };
        // Inside the limits the clamped ratio is the true one; outside only the mean's own ratio has a derivative.
        let true_ratio = p.camera[k] * inverse;
        camera[k] += by_ratio * inverse;
        camera[2] -= by_ratio * true_ratio * inverse;
    }
    out.mean = std::array::from_fn(|c| (0..3).map(|k| view.rotation[k][c] * camera[k]).sum());
    out
}

/// Gradient by the three axes on screen, and by their ln length, of the conic `C = (raw + low_pass)^-1` and of the
/// compensation `sqrt(det raw / det covariance)`.
///
/// With x_k an axis on screen and `y_k = C x_k`, the gradients are `-2 C dC y_k` and `-2 y_k . dC y_k`. For a needle, y is the
/// inverse of its length and would cancel out as a difference of C's entries times x, so it is computed from the adjugate,
/// `adj(raw) x_k = sum over the other axes j of (x_k x x_j) perp x_j`, in which the axis itself cancels exactly.
fn screen_backward(
    view: &RasterCamera,
    p: &Projection,
    s: &Splat,
    [da, db, dc]: [f32; 3],
    by_compensation: f32,
    by_log_scale: &mut [f32; 3],
) -> [[f32; 3]; 2] {
    let [a, b, c] = s.conic;
    let (determinant, low_pass) = (blurred_determinant(p), p.low_pass);
    let adjugate = [cross(&p.screen[1], &p.area), cross(&p.area, &p.screen[0])];
    // Below this determinant the derivative of its root overflows f32.
    let has_derivative = view.low_pass_compensation && p.raw_determinant > MIN_DETERMINANT;
    let factor = if has_derivative { s.compensation * by_compensation } else { 0.0 };
    let mut by_screen = [[0.0f32; 3]; 2];
    for k in 0..3 {
        let x = [p.screen[0][k], p.screen[1][k]];
        let y: [f32; 2] = std::array::from_fn(|r| (adjugate[r][k] + low_pass * x[r]) / determinant);
        let v = [da * y[0] + db * y[1], db * y[0] + dc * y[1]];
        let mut by = [-2.0 * (a * v[0] + b * v[1]), -2.0 * (b * v[0] + c * v[1])];
        let mut by_length = -2.0 * (y[0] * v[0] + y[1] * v[1]);
        if has_derivative {
            for r in 0..2 {
                let sharper = factor * (adjugate[r][k] / p.raw_determinant - y[r]);
                by[r] += sharper;
                by_length += sharper * x[r];
            }
        }
        (0..2).for_each(|r| by_screen[r][k] = by[r]);
        by_log_scale[k] += by_length;
    }
    by_screen
}
