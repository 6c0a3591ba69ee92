//! What a search for lights gives.

use relume_scene::SplitLight;

/// A light and the evidence for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectedLight {
    /// Where it is and how wide.
    pub light: SplitLight,
    /// Irradiance of a surface turned to it over that of an open one under the sky, by channel.
    pub strength: [f32; 3],
    /// Share by which it lowers the variation, against the same light with soft shadows.
    pub gain: f32,
}
