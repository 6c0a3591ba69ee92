//! Attribute rows on the device, computed from raw parameters.

use crate::DeviceError;
use crate::gpu::grow::grow;
use crate::gpu::permutations::{by_groups, groups};
use crate::gpu::raster::project::Projected;
use crate::gpu::{Buffer, Groups, Recorder, shaders, uniform};
use relume_layout::channel::Channels;

/// A projected view whose splats have attributes.
#[derive(Debug)]
pub struct Attributed<'r> {
    pub(in crate::gpu) projected: Projected<'r>,
    pub(in crate::gpu) channels: Channels,
    /// One row of `4 groups` floats per Gaussian, undefined where its splat reaches no tile.
    pub(in crate::gpu) rows: Buffer<[f32; 4]>,
}

impl<'r> Projected<'r> {
    /// Computes the attributes `channels` of every splat that reaches a tile.
    ///
    /// # Errors
    /// [`DeviceError::Misuse`] when `channels` or a buffer of the source do not fit the model, or as
    /// [`Gpu::buffer`](crate::gpu::Gpu::buffer).
    pub fn attributes(
        self,
        rec: &mut Recorder<'_>,
        channels: Channels,
    ) -> Result<Attributed<'r>, DeviceError> {
        use shaders::*;
        rec.stage("attributes");
        let (groups, n, source) = (groups(channels), self.gaussians(), &self.source);
        let is_full = matches!(channels, Channels::Full(_));
        let wrong = match &source.gathered {
            _ if is_full && channels != Channels::Full(source.layout.n_visibility as usize) => {
                Some("visibility coefficients")
            }
            _ if is_full && source.lacks_basis() => Some("indirect basis"),
            Some(gathered) if gathered.len() < 6 * n => Some("gathered light"),
            _ if source.globals.len() < 3 * source.layout.n_scores as usize => Some("prototypes"),
            _ => None,
        };
        if let Some(what) = wrong {
            return Err(DeviceError::Misuse(format!("attributes: the {what} do not fit the model")));
        }
        let raster = &mut *self.raster;
        let rows = grow(&raster.gpu, "attributes", &mut raster.attributes, n * groups)?;
        let bindings = [
            uniform(&self.camera),
            uniform(&source.layout),
            (&source.params).into(),
            (&source.globals).into(),
            (&self.splats).into(),
            source.gathered.as_ref().unwrap_or(&raster.nothing).into(),
            source.indirect_basis.as_ref().unwrap_or(&raster.nothing).into(),
            (&rows).into(),
        ];
        let kernels = [
            &ATTRIBUTES_1,
            &ATTRIBUTES_2,
            &ATTRIBUTES_4,
            &ATTRIBUTES_6,
            &ATTRIBUTES_8,
            &ATTRIBUTES_9,
            &ATTRIBUTES_12,
            &ATTRIBUTES_14,
            &ATTRIBUTES_18,
        ];
        rec.dispatch(by_groups(groups, kernels)?, Groups::Linear(n), &bindings);
        Ok(Attributed { projected: self, channels, rows })
    }
}
