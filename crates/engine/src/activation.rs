//! Activations: functions from unbounded parameters to their ranges.

use crate::cpu::exp_negative;

/// `1 / (1 + e^-x)`.
#[inline]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// Derivative of [`sigmoid`]: `s(x) s(-x)`, which stays accurate where `s` is nearly 1 and `1 - s` loses all digits.
#[inline]
pub fn sigmoid_derivative(x: f32) -> f32 {
    sigmoid(x) * sigmoid(-x)
}

/// `softmax(scores)` into `out` of the same length.
pub fn softmax<'b>(scores: &[f32], out: &'b mut [f32]) -> &'b [f32] {
    let top = scores.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    for (o, s) in out.iter_mut().zip(scores) {
        *o = exp_negative(s - top);
    }
    let total: f32 = out.iter().sum();
    out.iter_mut().for_each(|o| *o /= total);
    out
}
