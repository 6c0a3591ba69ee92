//! What a frame reads of a model.

use crate::gpu::buffer::Buffer;
use crate::gpu::model::{LayoutUniform, ModelBuffers};

/// A model in device memory as frames read it, with the indirect light of its surfaces.
#[derive(Debug, Clone)]
pub struct AttributeSource {
    /// Where each field is in `params`.
    pub layout: LayoutUniform,
    /// Planar parameters.
    pub params: Buffer<f32>,
    /// Prototypes (K x 3), then anything.
    pub globals: Buffer<f32>,
    /// Measured light: 6 floats a Gaussian of what is gathered, then, where lights beside the tables were measured, 4 floats a
    /// Gaussian of what arrives of them. `None` = nothing was measured: nothing is gathered and all of the lights arrives.
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

    /// True when the model reads the indirect basis and has none that fits.
    pub(super) fn lacks_basis(&self) -> bool {
        self.layout.reads_indirect_basis() && self.indirect_basis.as_ref().is_none_or(|b| b.len() < 48)
    }
}
