//! One optimisation step as an engine is asked for it, and what it comes to.

use crate::adam::{StepCounts, StepSizes};
use crate::light_rotation::LightRotation;
use crate::objective::StepWeights;
use relume_layout::channel::{Channels, StepChannels};
use relume_scene::{Camera, Field, Gaussians, IndirectForm, ShadeAt, ShadingOptions};

/// A photograph at one resolution, prepared for training.
#[derive(Debug, Clone)]
pub struct Photo {
    /// Camera in the normalised world.
    pub camera: Camera,
    /// Display-referred pixels over the background, row-major; none of a photograph that the device of a training holds.
    pub pixels: Vec<[f32; 3]>,
    /// Mask in [0, 1], row-major; empty when the capture has no masks.
    pub alpha: Vec<f32>,
    /// How the light stood in it.
    pub light: LightRotation,
}

/// Size at which photographs are trained on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PhotoSize {
    /// Half the configured resolution.
    Half,
    /// The configured resolution.
    Full,
}

/// Names a photograph, so that a device can keep it in its memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct PhotoId {
    /// Index among the training photographs.
    pub index: usize,
    /// Its size.
    pub size: PhotoSize,
    /// How often its pixels have changed.
    pub revision: usize,
}

/// The branches that a step trains.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Branches {
    /// Radiance branch alone.
    Radiance,
    /// Radiance branch, and depth-normal consistency.
    RadianceAndNormals,
    /// Radiance and physically based branch; visibility is measured.
    Both,
    /// Radiance and physically based branch; visibility has a gradient of its own.
    BothWithVisibility,
}

impl Branches {
    /// True when the physically based branch trains.
    pub fn is_physical(self) -> bool {
        matches!(self, Self::Both | Self::BothWithVisibility)
    }

    /// The channels a pass over `gaussians` needs. What is shaded at the Gaussians needs no visibility in the pixel.
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
    /// Its name.
    pub photo_id: PhotoId,
    /// What it was composited over, display-referred.
    pub background: [f32; 3],
    /// What trains.
    pub branches: Branches,
    /// The objective.
    pub weights: StepWeights,
    /// Adam's step sizes.
    pub sizes: StepSizes,
    /// Adam's step counts.
    pub counts: StepCounts,
}

/// What a step came to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepResult {
    /// The objective before the step.
    pub loss: f32,
    /// Mean squared error of the leading branch: the physically based one where it trains.
    pub mse: f32,
    /// False when the objective or a gradient was not finite: the state must not be built on.
    pub finite: bool,
}

/// What becomes of the visibility field when it is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldUpdate {
    /// It is replaced by the measurement.
    Replace,
    /// It is replaced by the first measurement only.
    Start,
    /// It is left alone.
    Keep,
}

/// How visibility and gathered light are measured (docs/MODEL.md section 6).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProbeMeasurement<'a> {
    /// Probe directions.
    pub directions: usize,
    /// Rounds of gathered light, 0 for none; nothing is gathered by a model that does not shade with it.
    pub bounces: usize,
    /// Turns of the light that light is gathered under, radians: a block of gathered light for each.
    pub rotations: &'a [f64],
    /// What the visibility field takes of it.
    pub field: FieldUpdate,
    /// Measurements in a row: each starts from the open side that the one before found.
    pub repeats: usize,
}
