//! A detected light.

use relume_scene::SplitLight;

/// A light and the evidence for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectedLight {
    /// Direction and angular radius.
    pub light: SplitLight,
    /// Irradiance of a surface that faces the light, relative to that of an unoccluded one under the sky, by channel.
    pub strength: [f32; 3],
    /// Share by which the light lowers the variation, compared with the same light with soft shadows.
    pub gain: f32,
}
