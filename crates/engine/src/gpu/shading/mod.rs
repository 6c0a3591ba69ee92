//! Shading of a whole view, forward and backward (docs/MODEL.md, section 4).

use bytemuck::{Pod, Zeroable};

use crate::DeviceError;
use crate::gpu::light::{Constants, LightBuffers};
use crate::gpu::model::{diffuse_code, shade_at_code, visibility_code};
use crate::gpu::permutations::{by_coefficients, groups};
use crate::gpu::shaders::{self, Kernel};
use crate::gpu::{Bind, Buffer, CameraUniform, Gpu, Groups, Recorder, uniform};
use relume_layout::channel::Channels;
use relume_scene::{DisplayRange, ShadingOptions};

#[cfg(test)]
pub(super) mod tests;

/// `Shading` of `shaders/shared/shading.wgsl`: options of the forward model.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct ShadingUniform {
    /// Display-referred background, padded.
    pub background: [f32; 4],
    /// 0 `Off`, 1 `Linear`, 2 `Sigmoid`.
    pub visibility_form: u32,
    /// 0 `AmbientOcclusion`, 1 `Directional`.
    pub diffuse_form: u32,
    /// 0 `Pixel`, 1 `Gaussian`.
    pub shade_at: u32,
    /// 1: images are compared through the sRGB curve.
    pub srgb: u32,
    /// 1: the diffuse term has the share of the light that the highlight leaves.
    pub conserves_energy: u32,
    /// Radiance at which display values end.
    pub peak: f32,
    pad_b: u32,
    pad_c: u32,
}

impl ShadingUniform {
    /// The forward model of `shading`.
    pub fn new(shading: &Shading) -> Self {
        let ([r, g, b], options) = (shading.background, &shading.options);
        Self {
            background: [r, g, b, 0.0],
            visibility_form: visibility_code(options.visibility),
            diffuse_form: diffuse_code(options.diffuse),
            shade_at: shade_at_code(options.shade_at),
            srgb: u32::from(options.srgb),
            conserves_energy: u32::from(options.conserves_energy),
            peak: shading.range.peak(),
            pad_b: 0,
            pad_c: 0,
        }
    }
}

/// `Composite` of `shaders/shared/composite.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct CompositeUniform {
    background: [f32; 4],
    n_pixels: u32,
    /// 1: images are compared through the sRGB curve.
    srgb: u32,
    /// Number of groups of the G-buffer gradient of a pass of shaded Gaussians.
    n_groups: u32,
    /// Radiance at which display values end.
    peak: f32,
}

impl CompositeUniform {
    /// For the radiance branch alone.
    fn new(camera: &CameraUniform, [r, g, b]: [f32; 3]) -> Self {
        let background = [r, g, b, 0.0];
        // The radiance branch blends display values, which have no peak.
        Self { background, n_pixels: camera.n_pixels, srgb: 0, n_groups: 0, peak: 0.0 }
    }

    /// For both branches of shaded Gaussians.
    fn shaded(camera: &CameraUniform, shading: &Shading, n_groups: u32) -> Self {
        let (srgb, peak) = (u32::from(shading.options.srgb), shading.range.peak());
        Self { srgb, n_groups, peak, ..Self::new(camera, shading.background) }
    }
}

/// One image per branch, or their gradients: rgb per pixel, display values in the range of the photographs; the fourth member is
/// unused.
#[derive(Debug, Clone)]
pub struct Images {
    /// Physically based branch.
    pub physical: Buffer<[f32; 4]>,
    /// Radiance branch.
    pub radiance: Buffer<[f32; 4]>,
}

impl Images {
    /// Memory for both branches of `pixels` pixels.
    ///
    /// # Errors
    /// [`DeviceError::TooLarge`] with the numbers, [`DeviceError::OutOfMemory`].
    pub fn new(gpu: &Gpu, pixels: usize) -> Result<Self, DeviceError> {
        Ok(Self {
            physical: gpu.buffer("the physical image", pixels)?,
            radiance: gpu.buffer("the radiance image", pixels)?,
        })
    }
}

/// Options of shading and the light.
#[derive(Debug, Clone)]
pub struct Shading {
    /// Options of the forward model.
    pub options: ShadingOptions,
    /// Background behind the images, display-referred.
    pub background: [f32; 3],
    /// Range of the display values of the images.
    pub range: DisplayRange,
    /// Tables of the light, for visibility of the surfaces' degree.
    pub light: LightBuffers,
    /// Tables of the reflectance model.
    pub constants: Constants,
}

impl Shading {
    /// Visibility coefficients of the surfaces: (degree + 1)^2 for degrees 0 to 6.
    pub(super) fn coefficients(&self) -> usize {
        self.light.layout.n_coefficients as usize
    }

    /// Dispatches `kernel` with the six bindings that all shading kernels share, followed by the given ones.
    pub(super) fn dispatch(
        &self,
        recorder: &mut Recorder<'_>,
        camera: &CameraUniform,
        kernel: &'static Kernel,
        groups: Groups,
        rest: Vec<Bind<'_>>,
    ) {
        let mut bindings = vec![
            uniform(camera),
            uniform(&ShadingUniform::new(self)),
            uniform(&self.light.layout),
            (&self.constants.buffer).into(),
            (&self.light.values).into(),
            (&self.light.values).into(),
        ];
        bindings.extend(rest);
        recorder.dispatch(kernel, groups, &bindings);
    }
}

/// Shades every pixel of a full G-buffer, `[group][pixel]`, and composites both branches over the background.
///
/// # Errors
/// When there is no kernel for the number of visibility coefficients.
pub fn shade(
    recorder: &mut Recorder<'_>,
    camera: &CameraUniform,
    shading: &Shading,
    gbuffer: &Buffer<[f32; 4]>,
    images: &Images,
) -> Result<(), DeviceError> {
    use shaders::*;
    let all = [&SHADE_1, &SHADE_4, &SHADE_9, &SHADE_16, &SHADE_25, &SHADE_36, &SHADE_49];
    let kernel = by_coefficients(shading.coefficients(), all)?;
    let rest = vec![gbuffer.into(), (&images.physical).into(), (&images.radiance).into()];
    shading.dispatch(recorder, camera, kernel, camera.tile_groups(), rest);
    Ok(())
}

/// Inputs and outputs of [`shade_backward`].
#[derive(Debug, Clone, Copy)]
pub struct ShadeGradients<'a> {
    /// The full G-buffer that was shaded.
    pub gbuffer: &'a Buffer<[f32; 4]>,
    /// Gradient by both images.
    pub by_images: &'a Images,
    /// Gradient by the buffers themselves (`objective::surface_terms`), two vec4 per pixel, planar.
    pub by_buffers: &'a Buffer<[f32; 4]>,
    /// Receives the gradient by the G-buffer, `[group][pixel]`, of the groups of `differentiated`.
    pub by_gbuffer: &'a Buffer<[f32; 4]>,
    /// Accumulates the gradient by the light tables, in their layout. The caller clears it.
    pub by_tables: &'a Buffer<f32>,
    /// `Material`, or `Full` to also differentiate indirect light and visibility.
    pub differentiated: Channels,
}

/// Gradients of the G-buffer and of the light tables.
///
/// # Errors
/// When there is no kernel for the number of visibility coefficients.
pub fn shade_backward(
    recorder: &mut Recorder<'_>,
    camera: &CameraUniform,
    shading: &Shading,
    gradients: &ShadeGradients<'_>,
) -> Result<(), DeviceError> {
    use shaders::*;
    let all = if let Channels::Full(_) = gradients.differentiated {
        [
            &SHADE_ALL_BACKWARD_1,
            &SHADE_ALL_BACKWARD_4,
            &SHADE_ALL_BACKWARD_9,
            &SHADE_ALL_BACKWARD_16,
            &SHADE_ALL_BACKWARD_25,
            &SHADE_ALL_BACKWARD_36,
            &SHADE_ALL_BACKWARD_49,
        ]
    } else {
        [
            &SHADE_BACKWARD_1,
            &SHADE_BACKWARD_4,
            &SHADE_BACKWARD_9,
            &SHADE_BACKWARD_16,
            &SHADE_BACKWARD_25,
            &SHADE_BACKWARD_36,
            &SHADE_BACKWARD_49,
        ]
    };
    let kernel = by_coefficients(shading.coefficients(), all)?;
    let rest = vec![
        gradients.gbuffer.into(),
        (&gradients.by_images.physical).into(),
        (&gradients.by_images.radiance).into(),
        gradients.by_buffers.into(),
        gradients.by_gbuffer.into(),
        gradients.by_tables.into(),
    ];
    shading.dispatch(recorder, camera, kernel, camera.tile_groups(), rest);
    Ok(())
}

/// Both branches of a pass of shaded Gaussians, composited over the background.
pub fn shaded_images(
    recorder: &mut Recorder<'_>,
    camera: &CameraUniform,
    shading: &Shading,
    gbuffer: &Buffer<[f32; 4]>,
    images: &Images,
) {
    let composite = CompositeUniform::shaded(camera, shading, 0);
    let bindings =
        [uniform(&composite), gbuffer.into(), (&images.physical).into(), (&images.radiance).into()];
    recorder.dispatch(&shaders::SHADED_IMAGES, Groups::Linear(camera.pixels()), &bindings);
}

/// Backward pass of [`shaded_images`]: the gradient of the G-buffer. The light tables get their gradient at the Gaussians.
pub fn shaded_images_backward(
    recorder: &mut Recorder<'_>,
    camera: &CameraUniform,
    shading: &Shading,
    gradients: &ShadeGradients<'_>,
) {
    let n_groups = groups(gradients.differentiated) as u32;
    let composite = CompositeUniform::shaded(camera, shading, n_groups);
    let bindings = [
        uniform(&composite),
        gradients.gbuffer.into(),
        (&gradients.by_images.physical).into(),
        (&gradients.by_images.radiance).into(),
        gradients.by_buffers.into(),
        gradients.by_gbuffer.into(),
    ];
    recorder.dispatch(&shaders::SHADED_IMAGES_BACKWARD, Groups::Linear(camera.pixels()), &bindings);
}

/// The radiance branch alone, for passes without material.
pub fn radiance_image(
    recorder: &mut Recorder<'_>,
    camera: &CameraUniform,
    background: [f32; 3],
    gbuffer: &Buffer<[f32; 4]>,
    radiance: &Buffer<[f32; 4]>,
) {
    let composite = CompositeUniform::new(camera, background);
    let bindings = [uniform(&composite), gbuffer.into(), radiance.into()];
    recorder.dispatch(&shaders::RADIANCE, Groups::Linear(camera.pixels()), &bindings);
}

/// Backward pass of [`radiance_image`] with the gradients by the buffers: writes one group of the G-buffer gradient, or two
/// for `channels` beyond `Colour`.
pub fn radiance_image_backward(
    recorder: &mut Recorder<'_>,
    camera: &CameraUniform,
    background: [f32; 3],
    by_radiance: &Buffer<[f32; 4]>,
    by_buffers: &Buffer<[f32; 4]>,
    by_gbuffer: &Buffer<[f32; 4]>,
    channels: Channels,
) {
    let composite = CompositeUniform::new(camera, background);
    let kernel = match channels {
        Channels::Colour => &shaders::RADIANCE_BACKWARD,
        _ => &shaders::RADIANCE_GEOMETRY_BACKWARD,
    };
    let bindings = [uniform(&composite), by_radiance.into(), by_buffers.into(), by_gbuffer.into()];
    recorder.dispatch(kernel, Groups::Linear(camera.pixels()), &bindings);
}
