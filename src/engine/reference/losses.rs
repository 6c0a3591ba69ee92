//! The terms of the objective (Eq. 15, 24, 25, 29-32).

use super::array::Array;
use super::compositing::Weights;
use super::tape::{Tape, Var};

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

/// Binary cross entropy of `sigmoid(logits)` against `labels`, averaged (Eq. 15).
pub fn binary_cross_entropy<'t>(logits: Var<'t>, labels: Var<'t>) -> Var<'t> {
    (logits.softplus() - logits * labels).mean()
}

/// Visibility labels from backward transmittance: for each of V splats the mean of `That` over the pixels,
/// weighted by its blending weights, and that weight's sum. Labels are data: no gradient flows through them.
pub fn backward_labels(weights: &Weights<'_>) -> (Array, Array) {
    let (w, t) = (weights.weights.value(), weights.backward.value());
    let count = w.shape()[1];
    let mut sums = vec![[0.0; 2]; count];
    for (i, (w, t)) in w.data().iter().zip(t.data()).enumerate() {
        sums[i % count][0] += w * t;
        sums[i % count][1] += w;
    }
    let labels = sums.iter().map(|[wt, w]| wt / w.max(1e-8)).collect();
    let totals = sums.iter().map(|s| s[1]).collect();
    (Array::new(&[count, 1], labels), Array::new(&[count, 1], totals))
}

/// A zero on the tape, for terms that have nothing to measure.
pub fn nothing(tape: &Tape) -> Var<'_> {
    tape.scalar(0.0)
}
