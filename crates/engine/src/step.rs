//! Input and result of one optimisation step.

use crate::adam::{StepCounts, StepSizes};
use crate::objective::StepWeights;
use crate::photo_light::{PhotoLight, TurnedLight};
use relume_layout::channel::{Channels, StepChannels};
use relume_scene::{Camera, DisplayRange, Field, Gaussians, IndirectForm, ShadeAt, ShadingOptions};

/// A photograph at one resolution, prepared for training.
#[derive(Debug, Clone)]
pub struct Photo {
    /// Camera in the normalised world.
    pub camera: Camera,
    /// Display values in `range` over the background, row-major; empty for a photograph that the training's device holds.
    pub pixels: Vec<[f32; 3]>,
    /// Mask in [0, 1], row-major; empty when the capture has no masks.
    pub alpha: Vec<f32>,
    /// Its light.
    pub light: PhotoLight,
    /// Range of the pixels, and of the images that are compared with them.
    pub range: DisplayRange,
}

/// Size of a photograph in training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PhotoSize {
    /// Half the configured resolution.
    Half,
    /// The configured resolution.
    Full,
}

/// Identifies a photograph, so that a device can keep it in its memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct PhotoId {
    /// Index among the training photographs.
    pub index: usize,
    /// Its size.
    pub size: PhotoSize,
    /// Number of changes of its pixels.
    pub revision: usize,
}

/// The branches that a step trains.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Branches {
    /// Radiance branch alone.
    Radiance,
    /// Radiance branch, and depth-normal consistency.
    RadianceAndNormals,
    /// Radiance and physically based branch; visibility has no gradient, it is measured.
    Both,
    /// Radiance and physically based branch; visibility has a gradient.
    BothWithVisibility,
}

impl Branches {
    /// True when the physically based branch trains.
    pub fn is_physical(self) -> bool {
        matches!(self, Self::Both | Self::BothWithVisibility)
    }

    /// The channels that a pass over `gaussians` needs. Models shaded at their Gaussians need no visibility in the pixel.
    pub fn channels(self, gaussians: &Gaussians, shading: &ShadingOptions) -> StepChannels {
        let full = Channels::Full(gaussians.width(Field::Visibility));
        let differentiated = match self {
            Self::Radiance => Channels::Colour,
            Self::RadianceAndNormals => Channels::Geometry,
            Self::Both if shading.indirect != IndirectForm::Learned => Channels::Material,
            Self::Both | Self::BothWithVisibility => full,
        };
        let in_pixel = self.is_physical() && shading.shade_at == ShadeAt::Pixel;
        StepChannels { blended: if in_pixel { full } else { differentiated }, differentiated }
    }
}

/// One optimisation step.
#[derive(Debug, Clone, Copy)]
pub struct Step<'a> {
    /// The photograph.
    pub photo: &'a Photo,
    /// Its identifier.
    pub photo_id: PhotoId,
    /// Background behind the photograph, display-referred.
    pub background: [f32; 3],
    /// The branches that train.
    pub branches: Branches,
    /// The objective.
    pub weights: StepWeights,
    /// Adam's step sizes.
    pub sizes: StepSizes,
    /// Adam's step counts.
    pub counts: StepCounts,
}

/// Result of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepResult {
    /// The objective before the step.
    pub loss: f32,
    /// Mean squared error of the leading branch: the physically based branch where it trains, else the radiance branch.
    pub mse: f32,
    /// False when the objective or a gradient was not finite; training must not continue from that state.
    pub finite: bool,
}

/// Effect of a measurement on the visibility field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldUpdate {
    /// The measurement replaces it.
    Replace,
    /// Only the first measurement replaces it.
    Start,
    /// It is unchanged.
    Keep,
}

/// Settings of a measurement of visibility and gathered light (docs/MODEL.md, section 6).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProbeMeasurement<'a> {
    /// Probe directions.
    pub directions: usize,
    /// Bounces of gathered light, 0 for none. Models that do not shade with gathered light gather none.
    pub bounces: usize,
    /// Lights, each of which gets a block of gathered light.
    pub lights: &'a [TurnedLight],
    /// Effect on the visibility field.
    pub field: FieldUpdate,
    /// Number of successive measurements; each starts from the open side that the previous one found.
    pub repeats: usize,
}
