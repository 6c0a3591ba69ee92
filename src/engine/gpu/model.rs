//! A model in device memory.

use bytemuck::{Pod, Zeroable};

use crate::engine::RowLayout;
use crate::engine::gpu::{Buffer, Gpu, GpuError};
use crate::scene::{DiffuseForm, Field, Gaussians, IndirectForm, NormalForm, ShadingOptions, VisibilityForm};

/// `Layout` of `shaders/shared/parameters.wgsl`: where each field starts in the planar parameter buffer.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[expect(missing_docs, reason = "the members are the shader's, described there")]
pub struct LayoutUniform {
    pub n: u32,
    pub n_scores: u32,
    pub n_visibility: u32,
    pub n_radiance: u32,
    pub mean: u32,
    pub log_scale: u32,
    pub quaternion: u32,
    pub opacity: u32,
    pub normal: u32,
    pub metal: u32,
    pub rough: u32,
    pub scores: u32,
    pub residual: u32,
    pub visibility: u32,
    pub indirect: u32,
    pub radiance: u32,
    pub normal_form: u32,
    pub indirect_form: u32,
    pub visibility_form: u32,
    pub diffuse_form: u32,
}

impl LayoutUniform {
    /// The layout of `g` under the forward model `options`.
    pub fn new(g: &Gaussians, options: &ShadingOptions) -> Self {
        let row = RowLayout::new(g);
        let n = g.len() as u32;
        let at = |field: Field| n * row.range(field).start as u32;
        Self {
            n,
            n_scores: g.prototypes() as u32,
            n_visibility: g.width(Field::Visibility) as u32,
            n_radiance: g.width(Field::Radiance) as u32 / 3,
            mean: at(Field::Mean),
            log_scale: at(Field::LogScale),
            quaternion: at(Field::Quaternion),
            opacity: at(Field::OpacityLogit),
            normal: at(Field::Normal),
            metal: at(Field::MetalLogit),
            rough: at(Field::RoughLogit),
            scores: at(Field::ProtoLogits),
            residual: at(Field::Residual),
            visibility: at(Field::Visibility),
            indirect: at(Field::Indirect),
            radiance: at(Field::Radiance),
            normal_form: match options.normal {
                NormalForm::Free => 0,
                NormalForm::ShortestAxis => 1,
            },
            indirect_form: match options.indirect {
                IndirectForm::Off => 0,
                IndirectForm::Learned => 1,
                IndirectForm::Gathered => 2,
            },
            visibility_form: match options.visibility {
                VisibilityForm::Off => 0,
                VisibilityForm::Linear => 1,
                VisibilityForm::Sigmoid => 2,
            },
            diffuse_form: match options.diffuse {
                DiffuseForm::AmbientOcclusion => 0,
                DiffuseForm::Directional => 1,
            },
        }
    }
}

/// All parameters of `g`, planar by field in storage order.
pub fn planar(g: &Gaussians) -> Vec<f32> {
    Field::ALL.iter().flat_map(|f| g.field(*f).iter().copied()).collect()
}

/// Writes a planar array back into `g`, which has its shape. Elements beyond the array's end are left alone.
pub fn from_planar(values: &[f32], g: &mut Gaussians) {
    let mut rest = values;
    for (_, _, data) in g.fields_mut() {
        let (head, tail) = rest.split_at(data.len().min(rest.len()));
        data[..head.len()].copy_from_slice(head);
        rest = tail;
    }
}

impl Gpu {
    /// The parameters of `g` in device memory.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] with the numbers when the model does not fit.
    pub fn upload_gaussians(&self, g: &Gaussians) -> Result<Buffer<f32>, GpuError> {
        self.upload("the Gaussians", &planar(g))
    }
}
