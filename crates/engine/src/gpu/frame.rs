//! A frame on the device: from attributes to images, and backward from the gradient of the images to that of the splats.
//! Training, rendering and the comparison of engines share this sequence of kernels.

use crate::DeviceError;
use crate::gpu::permutations::groups;
use crate::gpu::raster::{Blended, Differentiated, Projected};
use crate::gpu::shading::{
    Images, ShadeGradients, Shading, radiance_image, radiance_image_backward, shade, shade_backward,
    shaded_images, shaded_images_backward,
};
use crate::gpu::{Buffer, Recorder};
use relume_layout::channel::Channels;
use relume_layout::constants::EarlyStop;
use relume_scene::ShadeAt;

/// The branches of a frame.
#[derive(Debug, Clone)]
pub enum FrameBranches {
    /// The radiance branch alone, over this display-referred background.
    Radiance([f32; 3]),
    /// The radiance branch and the physically based one.
    Both(Box<Shading>),
}

/// Settings of a frame.
#[derive(Debug, Clone)]
pub struct FramePass {
    /// Channels that are blended: at least `Material` for both branches, `Full` where pixels are shaded.
    pub channels: Channels,
    /// When blending stops at a pixel.
    pub blending: EarlyStop,
    /// Branches of the frame.
    pub branches: FrameBranches,
}

/// Gradients that [`FramePass::backward`] reads and adds to.
#[derive(Debug, Clone, Copy)]
pub struct FrameGradients<'a> {
    /// Gradient by both images; the physically based one is read for [`FrameBranches::Both`] only.
    pub by_images: &'a Images,
    /// Gradient by the buffers themselves (`objective::surface_terms`), two vec4 per pixel, planar.
    pub by_buffers: &'a Buffer<[f32; 4]>,
    /// Accumulates the gradient by the light tables, in their layout. The caller clears it.
    pub by_tables: &'a Buffer<f32>,
    /// Channels that are differentiated.
    pub differentiated: Channels,
}

impl FramePass {
    /// Attributes, shading for models shaded at their Gaussians, and blending.
    ///
    /// # Errors
    /// [`DeviceError::Misuse`] when channels, branches and model are inconsistent, or as
    /// [`Gpu::buffer`](crate::gpu::Gpu::buffer).
    pub fn forward<'r>(
        &self,
        recorder: &mut Recorder<'_>,
        projected: Projected<'r>,
    ) -> Result<Blended<'r>, DeviceError> {
        let attributed = projected.attributes(recorder, self.channels)?;
        if let Some(shading) = self.shaded_at_gaussians() {
            attributed.shade(recorder, shading)?;
        }
        attributed.blend(recorder, self.blending)
    }

    /// The images of a frame of this pass; the physically based image for [`FrameBranches::Both`] only.
    ///
    /// # Errors
    /// [`DeviceError::Misuse`] when there is no kernel for the number of visibility coefficients.
    pub fn images(
        &self,
        recorder: &mut Recorder<'_>,
        frame: &Blended<'_>,
        images: &Images,
    ) -> Result<(), DeviceError> {
        recorder.stage("shade");
        let (camera, gbuffer) = (frame.camera(), frame.gbuffer());
        match &self.branches {
            FrameBranches::Radiance(background) => {
                radiance_image(recorder, camera, *background, gbuffer, &images.radiance);
            }
            FrameBranches::Both(shading) => match shading.options.shade_at {
                ShadeAt::Gaussian => shaded_images(recorder, camera, shading, gbuffer, images),
                ShadeAt::Pixel => shade(recorder, camera, shading, gbuffer, images)?,
            },
        }
        Ok(())
    }

    /// The backward pass through [`Self::images`] and [`Self::forward`] to the splats.
    ///
    /// # Errors
    /// As [`Self::forward`].
    pub fn backward<'r>(
        &self,
        recorder: &mut Recorder<'_>,
        mut frame: Blended<'r>,
        gradients: &FrameGradients<'_>,
    ) -> Result<Differentiated<'r>, DeviceError> {
        let (seen, carried) = (groups(self.channels), groups(gradients.differentiated));
        let by_gbuffer = frame.gradient_buffer(carried)?;
        recorder.stage("shade backward");
        // G-buffer read, its gradient written, images and buffer gradients read; four taps of a table per coefficient.
        let pixels = frame.camera().pixels() as u64;
        recorder.work(
            pixels * 16 * (seen + carried + 4) as u64,
            pixels * (600 + 4 * 3 * 4 * 4 * seen.saturating_sub(5) as u64),
        );
        self.images_backward(recorder, &frame, gradients, &by_gbuffer)?;
        let frame = frame.backward(recorder, &by_gbuffer, carried)?;
        if let Some(shading) = self.shaded_at_gaussians() {
            frame.shade_backward(recorder, shading, gradients.by_tables)?;
        }
        Ok(frame)
    }

    fn images_backward(
        &self,
        recorder: &mut Recorder<'_>,
        frame: &Blended<'_>,
        gradients: &FrameGradients<'_>,
        by_gbuffer: &Buffer<[f32; 4]>,
    ) -> Result<(), DeviceError> {
        let FrameGradients { by_images, by_buffers, by_tables, differentiated } = *gradients;
        let (camera, gbuffer) = (frame.camera(), frame.gbuffer());
        let by = ShadeGradients { gbuffer, by_images, by_buffers, by_gbuffer, by_tables, differentiated };
        match &self.branches {
            FrameBranches::Radiance(background) => radiance_image_backward(
                recorder,
                camera,
                *background,
                &by_images.radiance,
                by_buffers,
                by_gbuffer,
                self.channels,
            ),
            FrameBranches::Both(shading) => match shading.options.shade_at {
                ShadeAt::Gaussian => shaded_images_backward(recorder, camera, shading, &by),
                ShadeAt::Pixel => shade_backward(recorder, camera, shading, &by)?,
            },
        }
        Ok(())
    }

    /// The shading, for models shaded at their Gaussians.
    fn shaded_at_gaussians(&self) -> Option<&Shading> {
        match &self.branches {
            FrameBranches::Both(shading) if shading.options.shade_at == ShadeAt::Gaussian => Some(shading),
            _ => None,
        }
    }
}
