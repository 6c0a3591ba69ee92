//! Attribute rows on the device: from raw parameters to what is blended.

use crate::engine::channel::Channels;
use crate::engine::gpu::raster::{Raster, available, groups, no_kernel};
use crate::engine::gpu::scan::grow;
use crate::engine::gpu::shaders::Shader;
use crate::engine::gpu::{Buffer, GpuError, Groups, Recorder, shaders, uniform};

/// What attributes are made of, besides the splats.
#[derive(Debug, Clone, Copy)]
pub struct AttributeBuffers<'a> {
    /// Planar parameters.
    pub params: &'a Buffer<f32>,
    /// Prototypes (K x 3), then anything.
    pub globals: &'a Buffer<f32>,
    /// Measured indirect light, 6 floats a Gaussian; `None` = nothing was gathered.
    pub gathered: Option<&'a Buffer<f32>>,
    /// `E_j` of Eq. 20, 16 x 3; needed by `IndirectForm::Learned`.
    pub indirect_basis: Option<&'a Buffer<f32>>,
}

/// `indirect_form` of the layout that reads `indirect_basis`.
pub(super) const LEARNED: u32 = crate::engine::gpu::kernel_constants::INDIRECT_LEARNED;

impl Raster {
    /// Fills [`Raster::attributes`] for the splats of the prepared view.
    ///
    /// # Errors
    /// [`GpuError::Internal`] without prepared view or with buffers that do not fit it, or as
    /// [`Gpu::buffer`](crate::engine::gpu::Gpu::buffer).
    pub fn attributes(
        &mut self,
        rec: &mut Recorder<'_>,
        channels: Channels,
        source: &AttributeBuffers<'_>,
    ) -> Result<(), GpuError> {
        rec.stage("attributes");
        let p = self.prepared()?;
        let (groups, n) = (groups(channels), p.model.n as usize);
        let wrong = match (channels, source.gathered, source.indirect_basis) {
            (Channels::Full(c), ..) if c != p.model.n_visibility as usize => Some("visibility coefficients"),
            (Channels::Full(_), _, basis)
                if p.model.indirect_form == LEARNED && basis.is_none_or(|b| b.len() < 48) =>
            {
                Some("indirect basis")
            }
            (_, Some(g), _) if g.len() < 6 * n => Some("gathered light"),
            _ if source.globals.len() < 3 * p.model.n_scores as usize => Some("prototypes"),
            _ => None,
        };
        if let Some(what) = wrong {
            return Err(GpuError::Internal(format!("attributes: the {what} do not fit the model")));
        }
        let rows = grow(&self.gpu, "attributes", &mut self.attributes, n * groups)?;
        let bindings = [
            uniform(&p.view),
            uniform(&p.model),
            source.params.into(),
            source.globals.into(),
            available(&self.splats, "splats")?.into(),
            source.gathered.unwrap_or(&self.nothing).into(),
            source.indirect_basis.unwrap_or(&self.nothing).into(),
            (&rows).into(),
        ];
        rec.dispatch(attributes_shader(groups)?, Groups::Linear(n), &bindings);
        self.blended_groups = 0;
        Ok(())
    }
}

fn attributes_shader(groups: usize) -> Result<&'static Shader, GpuError> {
    Ok(match groups {
        1 => &shaders::ATTRIBUTES_1,
        2 => &shaders::ATTRIBUTES_2,
        4 => &shaders::ATTRIBUTES_4,
        6 => &shaders::ATTRIBUTES_6,
        8 => &shaders::ATTRIBUTES_8,
        9 => &shaders::ATTRIBUTES_9,
        12 => &shaders::ATTRIBUTES_12,
        14 => &shaders::ATTRIBUTES_14,
        18 => &shaders::ATTRIBUTES_18,
        _ => return Err(no_kernel(groups)),
    })
}
