//! The light of each Gaussian on the device, forward and backward.

use crate::engine::channel::Channels;
use crate::engine::gpu::attributes::LEARNED;
use crate::engine::gpu::raster::{Raster, available};
use crate::engine::gpu::shaders::{self, Shader};
use crate::engine::gpu::shading::{ShadeJob, by_coefficients};
use crate::engine::gpu::{AttributeBuffers, Bind, Buffer, GpuError, Groups, Recorder, uniform};

/// Coefficients behind four taps of three colours, multiplied and added forward; about twice that on the way back.
const OPERATIONS_A_COEFFICIENT: u64 = 24;
/// The rest of a surface's shading.
const OPERATIONS_A_SURFACE: u64 = 600;

impl Raster {
    /// Shades every Gaussian under `job`'s light: into the rows of `channels`, materials or all, that
    /// [`Raster::attributes`] made of `source`.
    ///
    /// # Errors
    /// [`GpuError::Internal`] without attributes, or when there is no kernel for the number of visibility coefficients.
    pub fn light(
        &self,
        rec: &mut Recorder<'_>,
        job: &ShadeJob<'_>,
        channels: Channels,
        source: &AttributeBuffers<'_>,
    ) -> Result<(), GpuError> {
        rec.stage("light");
        let attributes = available(&self.attributes, "attributes")?;
        self.shade_rows(
            rec,
            job,
            forward_shader(job.n_visibility, channels)?,
            source,
            vec![attributes.into()],
        )
    }

    /// Shades every Gaussian, whose rows are of materials, into a row of coverage and linear colour of `colours`. Rows of
    /// Gaussians that reach no tile are left as they are.
    ///
    /// # Errors
    /// As [`Raster::light`].
    pub fn light_colours(
        &self,
        rec: &mut Recorder<'_>,
        job: &ShadeJob<'_>,
        source: &AttributeBuffers<'_>,
        colours: &Buffer<[f32; 4]>,
    ) -> Result<(), GpuError> {
        use shaders::*;
        rec.stage("light");
        let all = [
            &LIGHT_COLOURS_1,
            &LIGHT_COLOURS_4,
            &LIGHT_COLOURS_9,
            &LIGHT_COLOURS_16,
            &LIGHT_COLOURS_25,
            &LIGHT_COLOURS_36,
            &LIGHT_COLOURS_49,
        ];
        let shader = by_coefficients(job.n_visibility, all)?;
        let attributes = available(&self.attributes, "attributes")?;
        self.shade_rows(rec, job, shader, source, vec![attributes.into(), colours.into()])
    }

    fn shade_rows(
        &self,
        rec: &mut Recorder<'_>,
        job: &ShadeJob<'_>,
        shader: &'static Shader,
        source: &AttributeBuffers<'_>,
        rest: Vec<Bind<'_>>,
    ) -> Result<(), GpuError> {
        let p = self.prepared()?;
        let (n, width) = (u64::from(p.model.n), job.n_visibility as u64);
        rec.work(n * 4 * (34 + width), n * (OPERATIONS_A_SURFACE + OPERATIONS_A_COEFFICIENT * width));
        let mut bindings = self.light_bindings(source)?;
        bindings.extend(rest);
        job.dispatch(rec, shader, Groups::Linear(p.model.n as usize), bindings);
        Ok(())
    }

    /// The way back through [`Raster::light`] of rows of `channels`, after [`Raster::blend_backward`] of all of them: adds
    /// to the splat gradients and to `by_tables`, the gradient by the light tables, laid out as they are.
    ///
    /// # Errors
    /// [`GpuError::Internal`] when nothing was blended backward, or as [`Raster::light`].
    pub fn light_backward(
        &self,
        rec: &mut Recorder<'_>,
        job: &ShadeJob<'_>,
        channels: Channels,
        source: &AttributeBuffers<'_>,
        by_tables: &Buffer<f32>,
    ) -> Result<(), GpuError> {
        rec.stage("light backward");
        let shader = backward_shader(job.n_visibility, channels)?;
        let p = self.prepared()?;
        let (n, width) = (u64::from(p.model.n), job.n_visibility as u64);
        rec.work(n * 4 * (66 + width), n * 2 * (OPERATIONS_A_SURFACE + OPERATIONS_A_COEFFICIENT * width));
        let mut bindings = self.light_bindings(source)?;
        bindings.extend([
            available(&self.attributes, "attributes")?.into(),
            available(&self.splat_gradients, "splat gradients")?.into(),
            by_tables.into(),
        ]);
        job.dispatch(rec, shader, Groups::Linear(p.model.n as usize), bindings);
        Ok(())
    }

    /// What a Gaussian's surface is made of, but for its row.
    fn light_bindings<'a>(&'a self, source: &AttributeBuffers<'a>) -> Result<Vec<Bind<'a>>, GpuError> {
        let p = self.prepared()?;
        if p.model.indirect_form == LEARNED && source.indirect_basis.is_none_or(|b| b.len() < 48) {
            return Err(GpuError::Internal("light: the indirect basis does not fit the model".to_owned()));
        }
        Ok(vec![
            uniform(&p.model),
            source.params.into(),
            available(&self.splats, "splats")?.into(),
            source.gathered.unwrap_or(&self.nothing).into(),
            source.indirect_basis.unwrap_or(&self.nothing).into(),
        ])
    }
}

fn forward_shader(n_visibility: usize, channels: Channels) -> Result<&'static Shader, GpuError> {
    use shaders::*;
    let all = match channels {
        Channels::Full(_) => [
            &LIGHT_GAUSSIANS_ALL_1,
            &LIGHT_GAUSSIANS_ALL_4,
            &LIGHT_GAUSSIANS_ALL_9,
            &LIGHT_GAUSSIANS_ALL_16,
            &LIGHT_GAUSSIANS_ALL_25,
            &LIGHT_GAUSSIANS_ALL_36,
            &LIGHT_GAUSSIANS_ALL_49,
        ],
        _ => [
            &LIGHT_GAUSSIANS_1,
            &LIGHT_GAUSSIANS_4,
            &LIGHT_GAUSSIANS_9,
            &LIGHT_GAUSSIANS_16,
            &LIGHT_GAUSSIANS_25,
            &LIGHT_GAUSSIANS_36,
            &LIGHT_GAUSSIANS_49,
        ],
    };
    by_coefficients(n_visibility, all)
}

fn backward_shader(n_visibility: usize, channels: Channels) -> Result<&'static Shader, GpuError> {
    use shaders::*;
    let all = match channels {
        Channels::Full(_) => [
            &LIGHT_GAUSSIANS_ALL_BACKWARD_1,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_4,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_9,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_16,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_25,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_36,
            &LIGHT_GAUSSIANS_ALL_BACKWARD_49,
        ],
        _ => [
            &LIGHT_GAUSSIANS_BACKWARD_1,
            &LIGHT_GAUSSIANS_BACKWARD_4,
            &LIGHT_GAUSSIANS_BACKWARD_9,
            &LIGHT_GAUSSIANS_BACKWARD_16,
            &LIGHT_GAUSSIANS_BACKWARD_25,
            &LIGHT_GAUSSIANS_BACKWARD_36,
            &LIGHT_GAUSSIANS_BACKWARD_49,
        ],
    };
    by_coefficients(n_visibility, all)
}
