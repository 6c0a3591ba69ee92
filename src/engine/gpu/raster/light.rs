//! The diffuse term at each Gaussian on the device (`DiffuseAt::Gaussian`), forward and backward.

use crate::engine::gpu::raster::{Raster, available};
use crate::engine::gpu::shaders;
use crate::engine::gpu::shading::{ShadeJob, by_coefficients};
use crate::engine::gpu::{Buffer, GpuError, Groups, Recorder, uniform};

/// Coefficients behind four taps of three colours, multiplied and added forward; about twice that on the way back.
const OPERATIONS_A_COEFFICIENT: u64 = 24;

/// What [`Raster::light_backward`] is given and where it writes, besides the rasteriser's own buffers.
#[derive(Debug, Clone, Copy)]
pub struct LightGradients<'a> {
    /// Gathered light that went into the attributes.
    pub gathered: Option<&'a Buffer<f32>>,
    /// Added to: gradient by the light tables, laid out as they are.
    pub by_tables: &'a Buffer<f32>,
    /// Whether the splat gradients are of all channels, not only those of `Material`.
    pub all_channels: bool,
}

impl Raster {
    /// Turns the gathered irradiance in the rows of all channels into diffuse radiance under `job`'s light, for models
    /// whose diffuse term is found at the Gaussians; nothing for others. After [`Raster::attributes`].
    ///
    /// # Errors
    /// [`GpuError::Internal`] without attributes, or when there is no kernel for the number of visibility coefficients.
    pub fn light(
        &self,
        rec: &mut Recorder<'_>,
        job: &ShadeJob<'_>,
        params: &Buffer<f32>,
    ) -> Result<(), GpuError> {
        use shaders::*;
        if !job.shading.is_diffuse_at_gaussians() {
            return Ok(());
        }
        rec.stage("diffuse");
        let all = [
            &LIGHT_GAUSSIANS_1,
            &LIGHT_GAUSSIANS_4,
            &LIGHT_GAUSSIANS_9,
            &LIGHT_GAUSSIANS_16,
            &LIGHT_GAUSSIANS_25,
            &LIGHT_GAUSSIANS_36,
            &LIGHT_GAUSSIANS_49,
        ];
        let shader = by_coefficients(job.n_visibility, all)?;
        let p = self.prepared()?;
        let (splats, attributes) =
            (available(&self.splats, "splats")?, available(&self.attributes, "attributes")?);
        let (n, width) = (u64::from(p.model.n), job.n_visibility as u64);
        rec.work(n * 16 * (6 + width / 4), n * OPERATIONS_A_COEFFICIENT * width);
        let rest = vec![uniform(&p.model), params.into(), splats.into(), attributes.into()];
        job.dispatch(rec, shader, Groups::Linear(p.model.n as usize), rest);
        Ok(())
    }

    /// The way back through [`Raster::light`], after [`Raster::blend_backward`]: adds to the splat gradients and to the
    /// gradient by the tables.
    ///
    /// # Errors
    /// [`GpuError::Internal`] when nothing was blended backward, or as [`Raster::light`].
    pub fn light_backward(
        &self,
        rec: &mut Recorder<'_>,
        job: &ShadeJob<'_>,
        params: &Buffer<f32>,
        to: &LightGradients<'_>,
    ) -> Result<(), GpuError> {
        if !job.shading.is_diffuse_at_gaussians() {
            return Ok(());
        }
        rec.stage("diffuse backward");
        let shader = backward_shader(job.n_visibility, to.all_channels)?;
        let p = self.prepared()?;
        let (n, width) = (u64::from(p.model.n), job.n_visibility as u64);
        rec.work(n * 16 * (12 + width / 4), n * 2 * OPERATIONS_A_COEFFICIENT * width);
        let rest = vec![
            uniform(&p.model),
            params.into(),
            available(&self.splats, "splats")?.into(),
            available(&self.attributes, "attributes")?.into(),
            to.gathered.unwrap_or(&self.nothing).into(),
            available(&self.splat_gradients, "splat gradients")?.into(),
            to.by_tables.into(),
        ];
        job.dispatch(rec, shader, Groups::Linear(p.model.n as usize), rest);
        Ok(())
    }
}

fn backward_shader(n_visibility: usize, all_channels: bool) -> Result<&'static shaders::Shader, GpuError> {
    use shaders::*;
    let all = if all_channels {
        [
            &LIGHT_GAUSSIANS_ALL_BACKWARD_1,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_4,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_9,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_16,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_25,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_36,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_49,
        ]
    } else {
        [
            &LIGHT_GAUSSIANS_BACKWARD_1,
            &LIGHT_GAUSSIANS_BACKWARD_4,
            &LIGHT_GAUSSIANS_BACKWARD_9,
            &LIGHT_GAUSSIANS_BACKWARD_16,
            &LIGHT_GAUSSIANS_BACKWARD_25,
            &LIGHT_GAUSSIANS_BACKWARD_36,
            &LIGHT_GAUSSIANS_BACKWARD_49,
        ]
    };
    by_coefficients(n_visibility, all)
}
