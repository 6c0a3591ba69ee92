//! Depths of the surfaces that pixels see.

use crate::DeviceError;
use crate::gpu::grow::grow;
use crate::gpu::permutations::groups;
use crate::gpu::raster::Blended;
use crate::gpu::rays::RayMemory;
use crate::gpu::{Buffer, Recorder, shaders, uniform};

impl RayMemory {
    /// Camera depth of the surface that each pixel of a frame with normals sees.
    ///
    /// # Errors
    /// As [`Gpu::buffer`](crate::gpu::Gpu::buffer).
    pub(super) fn surface_depths(
        &mut self,
        recorder: &mut Recorder<'_>,
        frame: &Blended<'_>,
    ) -> Result<Buffer<f32>, DeviceError> {
        let depths = grow(recorder.gpu(), "surface depths", &mut self.depths, frame.camera().pixels())?;
        let p = &frame.attributed.projected;
        let bindings = [
            uniform(frame.camera()),
            uniform(&[groups(frame.attributed.channels) as u32, 0, 0, 0]),
            (&p.splats).into(),
            (&frame.attributed.rows).into(),
            (&p.tiles.gaussian_of_slot).into(),
            (&p.tiles.first_slot).into(),
            frame.gbuffer().into(),
            (&depths).into(),
        ];
        recorder.stage("surface depths");
        recorder.dispatch(&shaders::SURFACE_DEPTHS, frame.camera().tile_groups(), &bindings);
        Ok(depths)
    }
}
