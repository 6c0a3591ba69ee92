//! Interface between a renderer and an engine: a model on a device, and lights prepared for it.

use std::sync::Arc;

use crate::{ColourMode, DeviceError, Frame, FrameJob, HostLight, HostModel, RayLight};
use relume_scene::Illumination;

/// A model on a device. Every device also has the model on the host.
pub trait FrameRenderer: Send + Sync {
    /// The model on the host.
    fn host(&self) -> &Arc<HostModel>;

    /// True unless frames are computed by the CPU engine.
    fn is_gpu(&self) -> bool;

    /// Greatest number of rows of a [`FrameJob`] of `width` pixels.
    fn max_rows(&self, width: usize, colour: ColourMode) -> usize;

    /// Prepares `light` for this model, including interreflection between its surfaces.
    ///
    /// # Errors
    /// When the device failed.
    fn prepare_light(self: Arc<Self>, light: &Illumination) -> Result<Box<dyn FrameLight>, DeviceError>;
}

/// A light prepared for a model on its device.
pub trait FrameLight: Send + Sync {
    /// Renders a frame from light tables.
    ///
    /// # Errors
    /// When the device failed.
    fn render(&self, job: &FrameJob<'_>) -> Result<Frame, DeviceError>;

    /// Renders a frame with light that is traced along rays. `rays` must belong to the environment from which this light was
    /// prepared, always with the same split: the device keeps their data.
    ///
    /// # Errors
    /// As [`Self::render`].
    fn render_by_rays(&self, job: &FrameJob<'_>, rays: &RayLight<'_>) -> Result<Frame, DeviceError>;

    /// This light on the host; `None` unless the CPU engine prepared it.
    fn on_host(&self) -> Option<&HostLight> {
        None
    }
}
