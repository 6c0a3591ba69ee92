//! Whether a training fits a device.

use crate::engine::RowLayout;
use crate::engine::channel::Channels;
use crate::engine::gpu::raster::GRADIENT_HEADER;
use crate::engine::gpu::{Gpu, GpuError};
use crate::scene::{Field, Gaussians};

/// How large a training will become, in terms of its configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TrainingSize {
    /// Setting `resolution`.
    pub resolution: u32,
    /// Pixels of the largest photograph.
    pub pixels: usize,
    /// Setting `initial_gaussians`.
    pub initial_gaussians: u32,
    /// Setting `max_gaussians`.
    pub max_gaussians: u32,
    /// Setting `probe_directions`.
    pub probe_directions: u32,
}

impl TrainingSize {
    /// Refuses a training whose largest array would not fit one binding of `gpu`: of the photographs' pixels, or of all
    /// its Gaussians, which have the widths of those of `g`.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`], which names the setting at fault.
    pub fn check(&self, gpu: &Gpu, g: &Gaussians) -> Result<(), GpuError> {
        let attributes = Channels::Full(g.width(Field::Visibility)).stored();
        let gradients = GRADIENT_HEADER + attributes;
        let floats = RowLayout::new(g).row.max(gradients).max(self.probe_directions as usize) as u64;
        let most = gpu.report().max_binding.min(gpu.report().max_buffer);
        let gbuffer = 4 * (attributes * self.pixels) as u64;
        if gbuffer > most {
            let what = format!("resolution: {} (photographs of {} pixels)", self.resolution, self.pixels);
            return Err(GpuError::TooLarge { what, needs: gbuffer, most });
        }
        let needs = floats * 4 * u64::from(self.max_gaussians.max(self.initial_gaussians));
        if needs <= most {
            return Ok(());
        }
        let fit = most / (4 * floats);
        let what = format!("max_gaussians: {} (at most {fit} fit this device)", self.max_gaussians);
        Err(GpuError::TooLarge { what, needs, most })
    }
}
