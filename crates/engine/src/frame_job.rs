//! What a renderer asks of a device, and what a device other than the CPU engine offers for it.

use std::any::Any;

use crate::{DeviceError, Frame, RasterCamera, RayLight, RayTree};
use relume_scene::Output;
use relume_scene::light::LightTables;

/// Probe directions behind the gathered light of a frame.
pub const PROBE_DIRECTIONS: usize = 96;
/// Rounds of gathered light of a frame.
pub const BOUNCES: usize = 3;

/// How the colour of a frame comes about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColourMode {
    /// Gaussians are shaded once and blended in three channels: `rgb` and `alpha` only, whatever the model.
    Alone,
    /// With a G-buffer, shaded where the model was trained to be.
    WithGBuffer,
}

/// A frame to make from tables of the light.
#[derive(Debug, Clone, Copy)]
pub struct FrameJob<'a> {
    /// Camera in the normalised world.
    pub view: RasterCamera,
    /// Sorted, without repetition.
    pub outputs: &'a [Output],
    /// How its colour comes about.
    pub colour: ColourMode,
    /// From model to capture units.
    pub depth_scale: f32,
}

/// A light in the memory of the device that prepared it.
pub type DeviceLight = Box<dyn Any + Send + Sync>;

/// A model on a device other than the CPU engine.
pub trait DeviceRenderer: Send + Sync {
    /// The light of `tables`, with what the model's surfaces send each other under it.
    ///
    /// # Errors
    /// When the device failed.
    fn prepare_light(&self, tables: &LightTables) -> Result<DeviceLight, DeviceError>;

    /// Renders.
    ///
    /// # Errors
    /// [`DeviceError::Misuse`] for a light of another device, otherwise when the device failed.
    fn render(&self, job: &FrameJob<'_>, light: &DeviceLight) -> Result<Frame, DeviceError>;

    /// Renders with light that is looked for along rays. `tree` gives the model's, which the device keeps; what it makes of
    /// `rays` it keeps with `light`, so a light has one environment and one split of it.
    ///
    /// # Errors
    /// As [`Self::render`].
    fn render_by_rays(
        &self,
        job: &FrameJob<'_>,
        light: &DeviceLight,
        rays: &RayLight<'_>,
        tree: &dyn Fn() -> RayTree,
    ) -> Result<Frame, DeviceError>;
}
