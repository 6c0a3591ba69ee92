//! The way back from the G-buffer to the splats, and the labels that come from the same sweep.

use crate::engine::gpu::raster::{GRADIENT_HEADER, Raster, Words, available, no_kernel};
use crate::engine::gpu::scan::grow;
use crate::engine::gpu::shaders::Shader;
use crate::engine::gpu::{Buffer, GpuError, Groups, Recorder, shaders, uniform};

impl Raster {
    /// Fills [`Raster::splat_gradients`] from the gradient of the G-buffer's first `groups` groups of channels
    /// (`[group][pixel]`; channels that are not differentiated are zero). Belongs to the last [`Raster::blend`].
    ///
    /// # Errors
    /// [`GpuError::Internal`] when nothing has been blended or the gradient is too short, or as
    /// [`Gpu::buffer`](crate::engine::gpu::Gpu::buffer).
    pub fn blend_backward(
        &mut self,
        rec: &mut Recorder<'_>,
        by_gbuffer: &Buffer<[f32; 4]>,
        groups: usize,
    ) -> Result<(), GpuError> {
        rec.stage("blend backward");
        let p = self.prepared()?;
        let blended = self.blended_groups;
        if groups > blended || by_gbuffer.len() < groups * p.view.pixels() {
            let text = format!("gradient of {groups} groups of channels after a pass over {blended}");
            return Err(GpuError::Internal(text));
        }
        let shader = backward_shader(groups)?;
        let n_floats = p.model.n as usize * (GRADIENT_HEADER + 4 * groups);
        let gradients = grow(&self.gpu, "splat gradients", &mut self.splat_gradients, n_floats)?;
        rec.clear(&gradients);
        let bindings = [
            uniform(&p.view),
            uniform(&Words([blended as u32, 0, 0, 0])),
            available(&self.splats, "splats")?.into(),
            available(&self.attributes, "attributes")?.into(),
            (&p.gaussian_of_slot).into(),
            (&p.first_slot).into(),
            available(&self.ends, "blended pixels")?.into(),
            by_gbuffer.into(),
            (&gradients).into(),
        ];
        rec.dispatch(shader, Groups::Grid(p.view.tiles[0], p.view.tiles[1]), &bindings);
        // As forward, with the gradient rows read and written; the channels once for the slope of alpha, once for theirs.
        let (row, sums) = (64 + 16 * groups as u64, 2 * 4 * (GRADIENT_HEADER + 4 * groups) as u64);
        let bytes =
            p.counts.instances as u64 * (row + sums) + p.view.pixels() as u64 * (16 * groups as u64 + 8);
        rec.work(bytes, p.pairs() * (40 + 16 * groups as u64));
        Ok(())
    }

    /// Fills [`Raster::labels`] for the prepared view: backward transmittance (Eq. 14-15) as weighted sum and sum of
    /// weights, over all pixels of the view.
    ///
    /// # Errors
    /// [`GpuError::Internal`] without prepared view, or as [`Gpu::buffer`](crate::engine::gpu::Gpu::buffer).
    pub fn backward_labels(&mut self, rec: &mut Recorder<'_>) -> Result<(), GpuError> {
        rec.stage("labels");
        let p = self.prepared()?;
        let labels = grow(&self.gpu, "backward labels", &mut self.labels, p.model.n as usize)?;
        rec.clear(&labels);
        let bindings = [
            uniform(&p.view),
            available(&self.splats, "splats")?.into(),
            (&p.gaussian_of_slot).into(),
            (&p.first_slot).into(),
            (&labels).into(),
        ];
        let tiles = Groups::Grid(p.view.tiles[0], p.view.tiles[1]);
        rec.dispatch(&shaders::BACKWARD_LABELS, tiles, &bindings);
        Ok(())
    }
}

fn backward_shader(groups: usize) -> Result<&'static Shader, GpuError> {
    Ok(match groups {
        1 => &shaders::BLEND_BACKWARD_1,
        2 => &shaders::BLEND_BACKWARD_2,
        4 => &shaders::BLEND_BACKWARD_4,
        6 => &shaders::BLEND_BACKWARD_6,
        8 => &shaders::BLEND_BACKWARD_8,
        9 => &shaders::BLEND_BACKWARD_9,
        12 => &shaders::BLEND_BACKWARD_12,
        14 => &shaders::BLEND_BACKWARD_14,
        18 => &shaders::BLEND_BACKWARD_18,
        _ => return Err(no_kernel(groups)),
    })
}
