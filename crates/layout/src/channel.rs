//! Channels of an attribute row and of the G-buffer. Both engines use these definitions. The build script of `relume-engine`
//! generates the shaders' constants from them (`build/generated.rs`).
//!
//! The order matters: a pass that needs fewer channels carries the first ones ([`Channels`]).

use std::ops::Range;

/// Coverage: the channel whose attribute is 1.
pub const COVERAGE: usize = 0;
/// Colour of the radiance branch, display-referred. A pass of [`Channels::Colour`] may blend another colour here.
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
/// Camera depth.
pub const DEPTH: usize = 16;
/// First visibility coefficient.
pub const VISIBILITY: usize = 20;

/// Radiance that a surface sends to the camera, W/(m^2 sr), linear. Rows of Gaussians that are shaded before blending
/// (`ShadeAt::Gaussian`) carry it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct OutgoingRadiance {
    /// Diffuse part.
    pub diffuse: [f32; 3],
    /// Specular part.
    pub specular: [f32; 3],
}

impl OutgoingRadiance {
    /// Channels of [`Self::total`].
    pub const TOTAL: Range<usize> = 13..16;
    /// Channels of [`Self::specular`]; zero in training passes, which need the total alone.
    pub const SPECULAR: Range<usize> = 17..20;
    /// Channel of a gradient row that holds the gradient by sheen, after the shading has consumed the gradient by
    /// [`Self::TOTAL`].
    pub const SHEEN_GRADIENT: usize = Self::TOTAL.start;

    /// Sum of both parts.
    pub fn total(&self) -> [f32; 3] {
        std::array::from_fn(|c| self.diffuse[c] + self.specular[c])
    }

    /// Adds `share` of `other`.
    pub fn add(&mut self, other: Self, share: f32) {
        for c in 0..3 {
            self.diffuse[c] += share * other.diffuse[c];
            self.specular[c] += share * other.specular[c];
        }
    }
}

/// Light in a row of attributes that are blended first and shaded in the pixel (`ShadeAt::Pixel`), linear.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct IncidentLight {
    /// Irradiance gathered from other surfaces, W/m^2.
    pub gathered: [f32; 3],
    /// Radiance from directions in which the environment is blocked, W/(m^2 sr).
    pub blocked: [f32; 3],
}

impl IncidentLight {
    /// Channels of [`Self::gathered`].
    pub const GATHERED: Range<usize> = 13..16;
    /// Channels of [`Self::blocked`].
    pub const BLOCKED: Range<usize> = 17..20;
}

/// Kind of light that a pass blends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RowLight {
    /// [`OutgoingRadiance`].
    Outgoing,
    /// [`IncidentLight`].
    Incident,
}

/// Channels that a kernel processes at once.
pub const GROUP: usize = 4;

/// A group is a scalar and a triple, or a triple and a scalar: the shaders write groups as `vec4f` of those two.
const _: () = {
    assert!(COVERAGE.is_multiple_of(GROUP) && RADIANCE.start == COVERAGE + 1);
    assert!(NORMAL.start.is_multiple_of(GROUP) && PLANE == NORMAL.end);
    assert!(ALBEDO.start.is_multiple_of(GROUP) && METAL == ALBEDO.end);
    assert!(ROUGH.is_multiple_of(GROUP) && DEPTH.is_multiple_of(GROUP) && VISIBILITY.is_multiple_of(GROUP));
    assert!(OutgoingRadiance::TOTAL.start == ROUGH + 1 && OutgoingRadiance::SPECULAR.start == DEPTH + 1);
    assert!(IncidentLight::GATHERED.start == ROUGH + 1 && IncidentLight::BLOCKED.start == DEPTH + 1);
};

/// The channels of a pass: the first ones of the list above.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channels {
    /// Coverage and one colour: the radiance branch alone, or the preview tier.
    Colour,
    /// Also normal and plane distance: radiance warm-up with depth-normal consistency.
    Geometry,
    /// Also material and the first triple of light: the usual training.
    Material,
    /// All channels, with this number of visibility coefficients.
    Full(usize),
}

impl Channels {
    /// Number of channels in use.
    pub const fn count(self) -> usize {
        match self {
            Self::Colour => RADIANCE.end,
            Self::Geometry => PLANE + 1,
            Self::Material => OutgoingRadiance::TOTAL.end,
            Self::Full(coefficients) => VISIBILITY + coefficients,
        }
    }

    /// Channels stored: `count` rounded up so that kernels work in whole groups.
    pub const fn stored(self) -> usize {
        self.count().next_multiple_of(GROUP)
    }
}

/// Channels of a training step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StepChannels {
    /// Channels that are blended.
    pub blended: Channels,
    /// The blended channels that the backward pass carries.
    pub differentiated: Channels,
}
