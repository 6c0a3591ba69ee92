//! Backward pass from the G-buffer to the splats, and the backward labels.

use crate::DeviceError;
use crate::gpu::grow::grow;
use crate::gpu::permutations::{by_groups, groups};
use crate::gpu::raster::blend::Blended;
use crate::gpu::raster::project::Projected;
use crate::gpu::raster::records::DispatchParams;
use crate::gpu::{Buffer, Recorder, shaders, uniform};

pub use relume_layout::kernel_constants::GRADIENT_HEADER;

/// A blended view with the gradients of its splats.
#[derive(Debug)]
pub struct Differentiated<'r> {
    pub(in crate::gpu) blended: Blended<'r>,
    /// Number of differentiated groups of channels.
    pub(in crate::gpu) groups: usize,
    /// One row of [`GRADIENT_HEADER`]` + 4 groups` floats per Gaussian.
    pub(in crate::gpu) splat_gradients: Buffer<f32>,
}

impl Differentiated<'_> {
    /// As [`Projected::backward_labels`].
    ///
    /// # Errors
    /// As there.
    pub fn backward_labels(&mut self, rec: &mut Recorder<'_>) -> Result<Buffer<[f32; 2]>, DeviceError> {
        self.blended.attributed.projected.backward_labels(rec)
    }
}

impl<'r> Blended<'r> {
    /// Memory for the gradient of the first `groups` groups of the G-buffer.
    ///
    /// # Errors
    /// As [`Gpu::buffer`](crate::gpu::Gpu::buffer).
    pub(in crate::gpu) fn gradient_buffer(&mut self, groups: usize) -> Result<Buffer<[f32; 4]>, DeviceError> {
        let p = &mut self.attributed.projected;
        let (raster, pixels) = (&mut *p.raster, p.camera.pixels());
        grow(&raster.gpu, "gradient of the G-buffer", &mut raster.by_gbuffer, groups * pixels)
    }

    /// Gradients of the splats from that of the G-buffer's first `groups` groups of channels (`[group][pixel]`; channels
    /// that are not differentiated are zero).
    ///
    /// # Errors
    /// [`DeviceError::Misuse`] when fewer groups were blended or the gradient is too short, or as
    /// [`Gpu::buffer`](crate::gpu::Gpu::buffer).
    pub fn backward(
        self,
        rec: &mut Recorder<'_>,
        by_gbuffer: &Buffer<[f32; 4]>,
        groups: usize,
    ) -> Result<Differentiated<'r>, DeviceError> {
        rec.stage("blend backward");
        let blended = self::groups(self.attributed.channels);
        let pixels = self.attributed.projected.camera.pixels();
        if groups > blended || by_gbuffer.len() < groups * pixels {
            let text = format!(
                "gradient of {groups} groups of channels in {} elements after a pass over {blended} in {pixels} pixels",
                by_gbuffer.len()
            );
            return Err(DeviceError::Misuse(text));
        }
        let kernel = backward_kernel(groups)?;
        let n_floats = self.attributed.projected.gaussians() * (GRADIENT_HEADER + 4 * groups);
        let raster = &mut *self.attributed.projected.raster;
        let splat_gradients = grow(&raster.gpu, "splat gradients", &mut raster.splat_gradients, n_floats)?;
        rec.clear(&splat_gradients);
        let p = &self.attributed.projected;
        let bindings = [
            uniform(&p.camera),
            uniform(&DispatchParams([blended as u32, 0, 0, 0])),
            (&p.splats).into(),
            (&self.attributed.rows).into(),
            (&p.tiles.gaussian_of_slot).into(),
            (&p.tiles.first_slot).into(),
            (&self.ends).into(),
            by_gbuffer.into(),
            (&splat_gradients).into(),
        ];
        rec.dispatch(kernel, p.camera.tile_groups(), &bindings);
        // As forward, plus gradient rows read and written; channels once for the derivative of alpha and once for their
        // own.
        let (row, sums) = (64 + 16 * groups as u64, 2 * 4 * (GRADIENT_HEADER + 4 * groups) as u64);
        let bytes = p.counts.instances as u64 * (row + sums) + pixels as u64 * (16 * groups as u64 + 8);
        rec.work(bytes, p.pairs() * (40 + 16 * groups as u64));
        Ok(Differentiated { blended: self, groups, splat_gradients })
    }
}

impl Projected<'_> {
    /// Backward transmittance of every Gaussian (Eq. 14-15) as weighted sum and sum of weights over all pixels of the view:
    /// `sum w That, sum w`.
    ///
    /// # Errors
    /// As [`Gpu::buffer`](crate::gpu::Gpu::buffer).
    pub fn backward_labels(&mut self, rec: &mut Recorder<'_>) -> Result<Buffer<[f32; 2]>, DeviceError> {
        rec.stage("labels");
        let n = self.gaussians();
        let raster = &mut *self.raster;
        let labels = grow(&raster.gpu, "backward labels", &mut raster.labels, n)?;
        rec.clear(&labels);
        let bindings = [
            uniform(&self.camera),
            (&self.splats).into(),
            (&self.tiles.gaussian_of_slot).into(),
            (&self.tiles.first_slot).into(),
            (&labels).into(),
        ];
        rec.dispatch(&shaders::BACKWARD_LABELS, self.camera.tile_groups(), &bindings);
        Ok(labels)
    }
}

fn backward_kernel(groups: usize) -> Result<&'static shaders::Kernel, DeviceError> {
    use shaders::*;
    let kernels = [
        &BLEND_BACKWARD_1,
        &BLEND_BACKWARD_2,
        &BLEND_BACKWARD_4,
        &BLEND_BACKWARD_6,
        &BLEND_BACKWARD_8,
        &BLEND_BACKWARD_9,
        &BLEND_BACKWARD_12,
        &BLEND_BACKWARD_14,
        &BLEND_BACKWARD_18,
    ];
    by_groups(groups, kernels)
}
