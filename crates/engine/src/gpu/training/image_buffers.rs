//! Buffers of the size of the image, and the terms of the objective on images and buffers.

use crate::gpu::objective::{ImageTerm, LossSlot, surface_terms};
use crate::gpu::raster::Blended;
use crate::gpu::shading::Images;
use crate::gpu::training::device_step::DeviceStep;
use crate::gpu::{Buffer, DevicePhoto, Gpu, Recorder};
use crate::{DeviceError, ImageWeights};
use relume_layout::channel::Channels;

/// Buffers of the size of the image.
#[derive(Debug, Clone)]
pub(super) struct ImageBuffers {
    pixels: usize,
    pub(super) images: Images,
    pub(super) by_images: Images,
    /// Partial derivatives of the image terms, three elements per pixel.
    partials: Buffer<[f32; 4]>,
    /// Gradient by the buffers themselves, two elements per pixel.
    pub(super) by_buffers: Buffer<[f32; 4]>,
}

impl ImageBuffers {
    /// The buffers in `slot`, replaced when they have another number of pixels.
    pub(super) fn at(slot: &mut Option<Self>, gpu: &Gpu, pixels: usize) -> Result<Self, DeviceError> {
        if let Some(image_buffers) = slot.as_ref().filter(|image_buffers| image_buffers.pixels == pixels) {
            return Ok(image_buffers.clone());
        }
        // The old buffers are freed first: both at once may not fit.
        *slot = None;
        let image_buffers = Self {
            pixels,
            images: Images::new(gpu, pixels)?,
            by_images: Images::new(gpu, pixels)?,
            partials: gpu.buffer("partial derivatives of the image terms", 3 * pixels)?,
            by_buffers: gpu.buffer("gradient by the buffers", 2 * pixels)?,
        };
        Ok(slot.insert(image_buffers).clone())
    }

    /// Adds the terms on the images and buffers of `frame` to `losses` and writes their gradients.
    pub(super) fn terms(
        &self,
        recorder: &mut Recorder<'_>,
        step: &DeviceStep,
        channels: Channels,
        photo: &DevicePhoto,
        frame: &Blended<'_>,
        losses: &Buffer<f32>,
    ) {
        recorder.stage("losses");
        let (camera, gbuffer) = (frame.camera(), frame.gbuffer());
        let term = |image, weights: &ImageWeights, slot| ImageTerm {
            camera,
            image,
            photo,
            slot,
            weights: *weights,
            partials: &self.partials,
        };
        if step.branches.is_physical() {
            let physical = term(&self.images.physical, &step.weights.physical, LossSlot::PhysicalL1);
            physical.record(recorder, &self.by_images.physical, losses);
        }
        let radiance = term(&self.images.radiance, &step.weights.radiance, LossSlot::RadianceL1);
        radiance.record(recorder, &self.by_images.radiance, losses);
        let (weights, buffers) = (&step.weights.surface, [gbuffer, &self.by_buffers]);
        surface_terms(recorder, camera, channels, weights, photo, buffers, losses);
    }
}
