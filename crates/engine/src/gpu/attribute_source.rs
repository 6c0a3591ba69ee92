//! The model data that a frame reads.

use crate::gpu::buffer::Buffer;
use crate::gpu::model::{LayoutUniform, ModelBuffers};

/// A model in device memory, as input of frames, with the indirect light of its surfaces.
#[derive(Debug, Clone)]
pub struct AttributeSource {
    /// Position of each field in `params`.
    pub layout: LayoutUniform,
    /// Planar parameters.
    pub params: Buffer<f32>,
    /// Prototypes (K x 3) first; the rest is not read.
    pub globals: Buffer<f32>,
    /// Measured light: 6 floats of gathered light per Gaussian, then, where dominant lights were measured, their 4 arriving
    /// shares per Gaussian. `None`: nothing was measured; no light is gathered and the dominant lights arrive unshadowed.
    pub gathered: Option<Buffer<f32>>,
    /// `E_j` of Eq. 20, 16 x 3; needed by `IndirectForm::Learned`.
    pub indirect_basis: Option<Buffer<f32>>,
}

impl AttributeSource {
    /// `model` without indirect light.
    pub fn new(model: &ModelBuffers) -> Self {
        Self {
            layout: model.layout,
            params: model.params.clone(),
            globals: model.globals.clone(),
            gathered: None,
            indirect_basis: None,
        }
    }

    /// True when the model needs the indirect basis, and it is missing or too short.
    pub(super) fn lacks_basis(&self) -> bool {
        self.layout.reads_indirect_basis() && self.indirect_basis.as_ref().is_none_or(|b| b.len() < 48)
    }
}
