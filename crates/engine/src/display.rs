//! The display curve (sRGB) and its derivative.

/// sRGB curve on [0, 1]; above 1 its power continues.
#[inline]
pub fn srgb(x: f32) -> f32 {
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// Inverse of [`srgb`].
#[inline]
pub fn linear_from_srgb(x: f32) -> f32 {
    if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

/// Derivative of [`srgb`] at `x`, where `srgb(x) = y`; computed without a second power.
#[inline]
pub fn srgb_derivative(x: f32, y: f32) -> f32 {
    if x <= 0.003_130_8 { 12.92 } else { (y + 0.055) / (2.4 * x) }
}
