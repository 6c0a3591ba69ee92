//! How far a pixel is blended.

/// A pixel whose transmittance is below this may be left; the weight missed is less than this in all.
pub const TRANSMITTANCE_STOP: f32 = 1e-4;

/// How far a pixel is blended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Blending {
    /// Until its transmittance is below [`TRANSMITTANCE_STOP`].
    EarlyStop,
    /// To the last splat.
    Complete,
}
