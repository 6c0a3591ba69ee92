//! Check that a training fits a device.

use crate::gpu::Gpu;
use crate::gpu::raster::GRADIENT_HEADER;
use crate::{DeviceError, RowLayout, TrainingLimits};
use relume_layout::channel::Channels;
use relume_scene::{Field, Gaussians};

impl TrainingLimits {
    /// Refuses a training whose largest array exceeds one binding of `gpu`: the pixels of the largest photograph, or the
    /// Gaussians, which have the widths of those of `g`.
    ///
    /// # Errors
    /// [`DeviceError::TooLarge`], which names the setting at fault.
    pub(super) fn check(&self, gpu: &Gpu, g: &Gaussians) -> Result<(), DeviceError> {
        let attributes = Channels::Full(g.width(Field::Visibility)).stored();
        let gradients = GRADIENT_HEADER + attributes;
        let floats = RowLayout::new(g).row.max(gradients).max(self.probe_directions as usize) as u64;
        let most = gpu.report().max_binding.min(gpu.report().max_buffer);
        let gbuffer = 4 * (attributes * self.pixels) as u64;
        if gbuffer > most {
            let what = format!("resolution: {} (photographs of {} pixels)", self.resolution, self.pixels);
            return Err(DeviceError::TooLarge { what, needs: gbuffer, most });
        }
        let needs = floats * 4 * u64::from(self.max_gaussians);
        if needs <= most {
            return Ok(());
        }
        let fit = most / (4 * floats);
        let what = format!("max_gaussians: {} (at most {fit} fit this device)", self.max_gaussians);
        Err(DeviceError::TooLarge { what, needs, most })
    }
}
