//! Parameter groups, step sizes and bias corrections of Adam (Kingma and Ba 2015), shared by both engines.

use relume_layout::constants::{ADAM_BETA1, ADAM_BETA2};
use relume_scene::Field;

/// Factor of the radiance step size for coefficients above degree 0.
pub const HIGHER_DEGREE_SHARE: f32 = 0.05;
/// Number of steps after which a bias correction is 1 in f32.
const MAX_STEPS: u32 = 100_000;

/// Parameters that start to train together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldGroup {
    /// Shape, opacity and the radiance branch: from the first step.
    Geometry,
    /// Parameters of the physically based branch alone, including prototypes and environment.
    Material,
}

impl FieldGroup {
    /// The group of `field`.
    pub fn of(field: Field) -> Self {
        use Field::{Indirect, MetalLogit, Normal, ProtoLogits, Residual, RoughLogit, Sheen, Visibility};
        match field {
            Normal | MetalLogit | RoughLogit | Sheen | ProtoLogits | Residual | Visibility | Indirect => {
                Self::Material
            }
            _ => Self::Geometry,
        }
    }
}

/// Factor of the field's step size for float `k` of a row.
pub fn share_of_step(field: Field, k: usize) -> f32 {
    if field == Field::Radiance && k >= 3 { HIGHER_DEGREE_SHARE } else { 1.0 }
}

/// Step sizes of one step; at 0 a field and its moments are unchanged.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StepSizes {
    /// Step size per [`Field`] discriminant.
    pub fields: [f32; Field::COUNT],
    /// Albedo prototypes.
    pub prototypes: f32,
    /// Raw environment texels.
    pub environment: f32,
}

impl StepSizes {
    /// All sizes times `factor`.
    #[must_use]
    pub fn scaled(mut self, factor: f32) -> Self {
        self.fields.iter_mut().for_each(|f| *f *= factor);
        self.prototypes *= factor;
        self.environment *= factor;
        self
    }
}

/// Number of steps that each [`FieldGroup`] has trained, including the current one: at least 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StepCounts {
    /// Geometry and radiance.
    pub geometry: u32,
    /// Material, visibility and light.
    pub material: u32,
}

impl StepCounts {
    /// Bias corrections of a group: `1 - beta_1^t` of the first moment, the root of `1 - beta_2^t` of the second.
    pub fn corrections(self, group: FieldGroup) -> [f32; 2] {
        let steps = match group {
            FieldGroup::Geometry => self.geometry,
            FieldGroup::Material => self.material,
        };
        let correction = |beta: f32| 1.0 - beta.powi(steps.clamp(1, MAX_STEPS) as i32);
        [correction(ADAM_BETA1), correction(ADAM_BETA2).sqrt()]
    }
}
