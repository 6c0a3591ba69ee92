//! Interface between a renderer and a device other than the CPU engine.

use std::any::Any;

use crate::{DeviceError, Frame, RasterCamera, RayLight, RayTree};
use relume_scene::Output;
use relume_scene::light::LightTables;

/// Number of probe directions for the gathered light of a frame.
pub const PROBE_DIRECTIONS: usize = 96;
/// Number of bounces of the gathered light of a frame.
pub const BOUNCES: usize = 3;

/// Computation of a frame's colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColourMode {
    /// Every model is shaded at its Gaussians and blended in three channels: outputs `rgb` and `alpha` only.
    Alone,
    /// With a G-buffer, shaded where the model's options place the shading.
    WithGBuffer,
}

/// A frame to render from light tables.
#[derive(Debug, Clone, Copy)]
pub struct FrameJob<'a> {
    /// Camera in the normalised world.
    pub view: RasterCamera,
    /// Requested outputs, sorted and without repetition.
    pub outputs: &'a [Output],
    /// Computation of its colour.
    pub colour: ColourMode,
    /// Factor from model to capture units.
    pub depth_scale: f32,
}

/// A light in the memory of the device that prepared it.
pub type DeviceLight = Box<dyn Any + Send + Sync>;

/// A model on a device other than the CPU engine.
pub trait DeviceRenderer: Send + Sync {
    /// Prepares the light of `tables`, with the light that the model's surfaces send each other under it.
    ///
    /// # Errors
    /// When the device failed.
    fn prepare_light(&self, tables: &LightTables) -> Result<DeviceLight, DeviceError>;

    /// Renders `job` under `light`.
    ///
    /// # Errors
    /// [`DeviceError::Misuse`] for a light of another device, otherwise when the device failed.
    fn render(&self, job: &FrameJob<'_>, light: &DeviceLight) -> Result<Frame, DeviceError>;

    /// Renders with light that is traced along rays. The device keeps the model's tree, which `tree` returns. It keeps the data
    /// of `rays` with `light`, so a light has one environment and one split.
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
