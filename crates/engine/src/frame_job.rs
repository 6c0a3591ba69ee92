//! A frame as a renderer requests it from an engine.

use crate::RasterCamera;
use relume_scene::Output;

/// Number of probe directions for the gathered light and the shadows of the sky of a frame.
pub const PROBE_DIRECTIONS: usize = 128;
/// Number of bounces of the gathered light of a frame.
pub const BOUNCES: usize = 3;

/// Computation of a frame's colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColourMode {
    /// Every model is shaded at its Gaussians and blended in three channels: outputs `rgb` and `alpha` only.
    Alone,
    /// With a G-buffer, shaded where the model's options place the shading.
    WithGBuffer,
}

/// A frame to render from light tables.
#[derive(Debug, Clone, Copy)]
pub struct FrameJob<'a> {
    /// Camera in the normalised world.
    pub view: RasterCamera,
    /// Requested outputs, sorted and without repetition.
    pub outputs: &'a [Output],
    /// Computation of its colour.
    pub colour: ColourMode,
    /// Factor from model to capture units.
    pub depth_scale: f32,
}
