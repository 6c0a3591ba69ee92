//! The terms of the objective (Eq. 15, 24, 25, 29-32).

use std::f64::consts::PI;

use glam::DVec3;

use super::array::Array;
use super::compositing::Weights;
use super::tape::Var;
use relume_scene::light::{LUMINANCE, LightColour, UPWARD_LUMINANCE};

/// Mean absolute error of two images.
pub fn mean_absolute_error<'t>(image: Var<'t>, target: Var<'t>) -> Var<'t> {
    (image - target).abs().mean()
}

/// Normalised Gaussian window of an odd number of taps.
pub fn gaussian_window(taps: usize, sigma: f64) -> Vec<f64> {
    let tap = |i: usize| (-((i as f64 - (taps / 2) as f64).powi(2)) / (2.0 * sigma * sigma)).exp();
    let sum: f64 = (0..taps).map(tap).sum();
    (0..taps).map(|i| tap(i) / sum).collect()
}

/// `1 - SSIM` of two (H, W, 3) images in [0, 1], windows padded with zeros.
pub fn structural_dissimilarity<'t>(image: Var<'t>, target: Var<'t>, window: &[f64]) -> Var<'t> {
    let local = |x: Var<'t>| x.convolved(0, window).convolved(1, window);
    let (c1, c2) = (0.01f64.powi(2), 0.03f64.powi(2));
    let (ma, mb) = (local(image), local(target));
    let variance_a = local(image * image) - ma * ma;
    let variance_b = local(target * target) - mb * mb;
    let covariance = local(image * target) - ma * mb;
    let luminance = (2.0 * (ma * mb) + c1) / (ma * ma + mb * mb + c1);
    let structure = (2.0 * covariance + c2) / (variance_a + variance_b + c2);
    1.0 - (luminance * structure).mean()
}

/// Edge-aware smoothness of an (H, W, C) G-buffer channel guided by the (H, W, 3) photograph (Eq. 32).
pub fn edge_aware_smoothness<'t>(buffer: Var<'t>, guide: Var<'t>) -> Var<'t> {
    let along = |axis: usize| {
        let step = |x: Var<'t>| {
            let size = x.value().shape()[axis];
            (x.slice(axis, 1..size) - x.slice(axis, 0..size - 1)).abs().mean_last()
        };
        (step(buffer) * (-step(guide)).exp()).mean()
    };
    along(0) + along(1)
}

/// Mean absolute deviation of each texel's channels from their mean (Eq. 31), of (texels, 3).
pub fn light_neutrality(environment: Var<'_>) -> Var<'_> {
    (environment - environment.mean_last()).abs().mean()
}

/// `ln(Y / (pi Y'))^2`: Y is the luminance of the irradiance of a surface facing up under `environment` (texels, 3), Y' the
/// luminance of a white one in a well-exposed photograph. `texels` are directions and solid angles.
pub fn exposure<'t>(environment: Var<'t>, texels: &[(DVec3, f64)]) -> Var<'t> {
    let shares = texels.iter().map(|(d, w)| d.z.max(0.0) * w / PI).collect();
    let shares = environment.tape.input(Array::new(&[texels.len(), 1], shares));
    let channels = environment.tape.input(Array::new(&[1, 3], LUMINANCE.map(f64::from).to_vec()));
    let log = (environment * channels * shares).sum().at_least(1e-6).ln() - f64::from(UPWARD_LUMINANCE).ln();
    log * log
}

/// `t(b - b')^2 + t(g - g')^2`, t the part of a distance beyond the `tolerance`, with `b = ln(Y_blue / Y_red)` and `g = ln(Y_green^2 / (Y_red Y_blue))` of the same surface's
/// irradiance Y; b' and g' are those of `wanted`.
pub fn light_colour<'t>(
    environment: Var<'t>,
    texels: &[(DVec3, f64)],
    wanted: LightColour,
    tolerance: f64,
) -> Var<'t> {
    let shares = texels.iter().map(|(d, w)| d.z.max(0.0) * w / PI).collect();
    let shares = environment.tape.input(Array::new(&[texels.len(), 1], shares));
    let up = |c: usize| (environment.slice(1, c..c + 1) * shares).sum().at_least(1e-6).ln();
    let beyond = |x: Var<'t>| (x - tolerance).at_least(0.0) - (-x - tolerance).at_least(0.0);
    let blue = beyond(up(2) - up(0) - f64::from(wanted.blue_over_red));
    let green = beyond(2.0 * up(1) - up(0) - up(2) - f64::from(wanted.green));
    blue * blue + green * green
}

/// Mean of each Gaussian's smallest standard deviation, from log-scales (N, 3).
pub fn flatness(log_scales: Var<'_>) -> Var<'_> {
    let smallest: Vec<usize> = log_scales.value().smallest_columns();
    let cells = smallest.iter().enumerate().map(|(i, column)| 3 * i + column).collect::<Vec<_>>();
    log_scales.reshaped(&[3 * smallest.len()]).gather(0, &cells).exp().mean()
}

/// `-ln` of the probability that exactly one prototype is active, averaged over the rows of (N, K) (Eq. 24).
pub fn aggregation(assignment: Var<'_>) -> Var<'_> {
    const FLOOR: f64 = 1e-6;
    let absent = (1.0 - assignment).at_least(FLOOR).ln();
    let others_absent = (absent.sum_last() - absent).exp();
    -assignment.dot(others_absent).at_least(FLOOR).ln().mean()
}

/// Mean L1 norm of the albedo residuals (N, 3) (Eq. 25).
pub fn residual_sparsity(residual: Var<'_>) -> Var<'_> {
    residual.abs().sum_last().mean()
}

/// Binary cross entropy of `sigmoid(logits)` against `labels`, row by row.
pub fn cross_entropy_of_logits<'t>(logits: Var<'t>, labels: Var<'t>) -> Var<'t> {
    logits.softplus() - logits * labels
}

/// Binary cross entropy of probabilities, clamped to 1e-3 .. 1 - 1e-3, against `labels`, row by row (Eq. 15).
pub fn cross_entropy<'t>(probabilities: Var<'t>, labels: Var<'t>) -> Var<'t> {
    let p = probabilities.clamp_recoverable(1e-3, 1.0 - 1e-3);
    -(labels * p.ln() + (1.0 - labels) * (1.0 - p).ln())
}

/// Visibility labels from backward transmittance, (V, 1): the mean of `That` over the pixels, weighted by the splat's blending
/// weights; and the sum of those weights, (V, 1).
pub fn backward_labels<'t>(weights: &Weights<'t>) -> (Var<'t>, Var<'t>) {
    let totals = weights.weights.sum_axis(0);
    let labels = (weights.weights * weights.backward).sum_axis(0) / totals.at_least(1e-8);
    (labels.transposed(), totals.transposed())
}

/// Mean squared distance over the sphere of visibility fields (N, J) from measured ones.
pub fn probe_distance<'t>(coefficients: Var<'t>, measured: Var<'t>) -> Var<'t> {
    let difference = coefficients - measured;
    difference.dot(difference).mean() * (1.0 / (4.0 * PI))
}
