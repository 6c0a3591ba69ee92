//! The G-buffer's channels. Order matters: work that needs fewer of them takes a prefix.

use std::ops::Range;

/// Coverage: the channel whose attribute is 1.
pub const COVERAGE: usize = 0;
/// Colour of the radiance branch, display-referred; the preview tier puts shaded colour here.
pub const RADIANCE: Range<usize> = 1..4;
/// World-space normal.
pub const NORMAL: Range<usize> = 4..7;
/// Signed distance of the splat's plane from the camera centre.
pub const PLANE: usize = 7;
/// Linear base colour.
pub const ALBEDO: Range<usize> = 8..11;
/// Metalness.
pub const METAL: usize = 11;
/// Roughness.
pub const ROUGH: usize = 12;
/// Light: of a lit pass the radiance that leaves for the camera, else gathered irradiance.
pub const LIGHT: Range<usize> = 13..16;
/// Of the gradient of a lit pass by a Gaussian, once [`LIGHT`] has been passed on: that by sheen.
pub const SHEEN: usize = LIGHT.start;
/// Camera depth.
pub const DEPTH: usize = 16;
/// Of a lit pass the specular part of [`LIGHT`], else radiance from where the environment is blocked.
pub const INDIRECT: Range<usize> = 17..20;
/// First visibility coefficient.
pub const VISIBILITY: usize = 20;

/// How many channels a pass carries: a prefix of the list above.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channels {
    /// Coverage and one colour: the radiance branch alone, or the preview tier.
    Colour,
    /// Also normal and plane distance: radiance warm-up with depth-normal consistency.
    Geometry,
    /// Also material and light, without what only shading in the pixel and pictures need: the usual training.
    Material,
    /// Everything, visibility of this many coefficients included.
    Full(usize),
}

impl Channels {
    /// Number of channels in use.
    pub fn count(self) -> usize {
        match self {
            Self::Colour => 4,
            Self::Geometry => 8,
            Self::Material => 16,
            Self::Full(coefficients) => VISIBILITY + coefficients,
        }
    }

    /// Channels stored: `count` rounded up so that kernels work in whole blocks of 4.
    pub fn stored(self) -> usize {
        self.count().next_multiple_of(4)
    }
}
