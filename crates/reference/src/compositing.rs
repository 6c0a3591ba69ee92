//! Dense front-to-back compositing: every Gaussian at every pixel, with forward and backward transmittance.

use super::ops::ScanDirection;
use super::projection::{Splats, pixel_centres};
use super::tape::{Tape, Var};
use relume_scene::Camera;

/// Limits of a Gaussian's alpha.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlphaLimits {
    /// Largest alpha of one layer.
    pub largest: f64,
    /// Alphas up to this one count as 0.
    pub cutoff: f64,
}

impl Default for AlphaLimits {
    fn default() -> Self {
        Self { largest: 0.99, cutoff: 1.0 / 255.0 }
    }
}

/// Blending weights of P pixels and V splats.
pub struct Weights<'t> {
    /// `w = T alpha`, (P, V).
    pub weights: Var<'t>,
    /// Backward transmittance `That_i = prod_{j>i} (1 - alpha_j)` (Eq. 14), (P, V).
    pub backward: Var<'t>,
    /// Accumulated alpha, (P, 1).
    pub alpha: Var<'t>,
}

/// Composites splats of the given opacities (V, 1), already in front-to-back order.
pub fn composite<'t>(
    tape: &'t Tape,
    splats: &Splats<'t>,
    opacities: Var<'t>,
    camera: &Camera,
    limits: AlphaLimits,
) -> Weights<'t> {
    let row = |column: Var<'t>| column.transposed();
    let (x, y) = pixel_centres(tape, camera);
    let dx = x - row(splats.pixels.column(0));
    let dy = y - row(splats.pixels.column(1));
    let [a, b, c] = [0, 1, 2].map(|i| row(splats.conics.column(i)));
    let power = -0.5 * (a * dx * dx + 2.0 * (b * dx * dy) + c * dy * dy);
    let alpha = (row(opacities) * power.at_most(0.0).exp()).at_most(limits.largest);
    let drawn = alpha.value().map(|a| f64::from(u8::from(a > limits.cutoff)));
    let alpha = alpha * tape.input(drawn);

    // Eq. 4 and 14: transmittance of the layers in front, and of the layers behind.
    let forward = (1.0 - alpha).exclusive_product(ScanDirection::Forward);
    let backward = (1.0 - alpha).exclusive_product(ScanDirection::Backward);
    let weights = forward * alpha;
    Weights { weights, backward, alpha: weights.sum_last() }
}
