//! Front-to-back blending of attribute rows into a G-buffer (Eq. 4-5).

use crate::DeviceError;
use crate::gpu::grow::grow;
use crate::gpu::permutations::{by_groups, groups};
use crate::gpu::raster::attributes::Attributed;
use crate::gpu::raster::project::Projected;
use crate::gpu::raster::records::{BlendEnd, DispatchParams};
use crate::gpu::shaders::Kernel;
use crate::gpu::{Buffer, CameraUniform, Recorder, shaders, uniform};
use relume_layout::constants::{EarlyStop, TRANSMITTANCE_STOP};

/// Transmittance at which complete blending stops: further splats change no digit, and transmittances can still be
/// recovered by division.
const LAST_TRANSMITTANCE: f32 = 1e-30;

/// A view with its G-buffer.
#[derive(Debug)]
pub struct Blended<'r> {
    pub(in crate::gpu) attributed: Attributed<'r>,
    pub(super) gbuffer: Buffer<[f32; 4]>,
    /// End of the blending per pixel.
    pub(super) ends: Buffer<BlendEnd>,
}

impl Blended<'_> {
    /// The camera of the view.
    pub fn camera(&self) -> &CameraUniform {
        &self.attributed.projected.camera
    }

    /// The G-buffer, `[group][pixel]`; elements beyond the view's are undefined.
    pub fn gbuffer(&self) -> &Buffer<[f32; 4]> {
        &self.gbuffer
    }
}

impl<'r> Attributed<'r> {
    /// Blends the rows into a G-buffer.
    ///
    /// # Errors
    /// As [`Gpu::buffer`](crate::gpu::Gpu::buffer).
    pub fn blend(self, rec: &mut Recorder<'_>, blending: EarlyStop) -> Result<Blended<'r>, DeviceError> {
        use shaders::*;
        rec.stage("blend");
        let groups = groups(self.channels);
        let kernels =
            [&BLEND_1, &BLEND_2, &BLEND_4, &BLEND_6, &BLEND_8, &BLEND_9, &BLEND_12, &BLEND_14, &BLEND_18];
        let kernel = by_groups(groups, kernels)?;
        let pixels = self.projected.camera.pixels();
        let raster = &mut *self.projected.raster;
        let gbuffer = grow(&raster.gpu, "the G-buffer", &mut raster.gbuffer, groups * pixels)?;
        let ends = grow(&raster.gpu, "blend ends", &mut raster.ends, pixels)?;
        let p = &self.projected;
        let least = match blending {
            EarlyStop::WhenSaturated => TRANSMITTANCE_STOP,
            EarlyStop::Never => LAST_TRANSMITTANCE,
        };
        p.blend_rows(rec, kernel, least, [&self.rows, &gbuffer], &ends);
        // Footprints and rows once per tile, sums once per pixel; an exponential and 4 groups of multiply-adds per pair.
        let row = 64 + 16 * groups as u64;
        let bytes = p.counts.instances as u64 * row + pixels as u64 * (16 * groups as u64 + 8);
        rec.work(bytes, p.pairs() * (14 + 8 * groups as u64));
        Ok(Blended { attributed: self, gbuffer, ends })
    }
}

impl Projected<'_> {
    /// Blends rows of two groups per Gaussian into `[group][pixel]`, until pixels saturate.
    pub(in crate::gpu) fn blend_pairs(
        &self,
        rec: &mut Recorder<'_>,
        rows: &Buffer<[f32; 4]>,
        blended: &Buffer<[f32; 4]>,
        ends: &Buffer<BlendEnd>,
    ) {
        self.blend_rows(rec, &shaders::BLEND_2, TRANSMITTANCE_STOP, [rows, blended], ends);
    }

    fn blend_rows(
        &self,
        rec: &mut Recorder<'_>,
        kernel: &'static Kernel,
        least_transmittance: f32,
        [rows, blended]: [&Buffer<[f32; 4]>; 2],
        ends: &Buffer<BlendEnd>,
    ) {
        let bindings = [
            uniform(&self.camera),
            uniform(&DispatchParams([least_transmittance.to_bits(), 0, 0, 0])),
            (&self.splats).into(),
            rows.into(),
            (&self.tiles.gaussian_of_slot).into(),
            (&self.tiles.first_slot).into(),
            blended.into(),
            ends.into(),
        ];
        rec.dispatch(kernel, self.camera.tile_groups(), &bindings);
    }
}
