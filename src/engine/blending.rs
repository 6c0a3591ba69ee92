//! How far a pixel is blended.

/// A pixel whose transmittance is below this may be left; the weight missed is less than this in all.
pub const TRANSMITTANCE_STOP: f32 = 1e-4;
