//! Where in the world the surfaces are that pixels see.

use crate::engine::DeviceError;
use crate::engine::gpu::grow::grow;
use crate::engine::gpu::permutations::groups;
use crate::engine::gpu::raster::Blended;
use crate::engine::gpu::rays::RayMemory;
use crate::engine::gpu::{Buffer, Recorder, shaders, uniform};

impl RayMemory {
    /// Camera depth of the surface that each pixel of a frame with normals sees.
    ///
    /// # Errors
    /// As [`Gpu::buffer`](crate::engine::gpu::Gpu::buffer).
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
