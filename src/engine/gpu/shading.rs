//! Shading of a whole view, forward and backward (docs/MODEL.md section 4).

use bytemuck::{Pod, Zeroable};

use crate::engine::channel::Channels;
use crate::engine::gpu::kernel_constants as codes;
use crate::engine::gpu::light::{Constants, LightBuffers};
use crate::engine::gpu::raster::groups;
use crate::engine::gpu::shaders::{self, Shader};
use crate::engine::gpu::{Buffer, CameraUniform, Gpu, GpuError, Groups, Recorder, uniform};
use crate::scene::{DiffuseForm, ShadeAt, ShadingOptions, VisibilityForm};

#[cfg(test)]
pub(super) mod tests;

/// `Shading` of `shaders/shared/shading.wgsl`: the forward model.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct ShadingUniform {
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
}

impl ShadingUniform {
    /// The forward model `options` over a display-referred `background`.
    pub fn new(options: &ShadingOptions, background: [f32; 3]) -> Self {
        let [r, g, b] = background;
        Self {
            background: [r, g, b, 0.0],
            visibility_form: match options.visibility {
                VisibilityForm::Off => codes::VISIBILITY_OFF,
                VisibilityForm::Linear => codes::VISIBILITY_LINEAR,
                VisibilityForm::Sigmoid => codes::VISIBILITY_SIGMOID,
            },
            diffuse_form: match options.diffuse {
                DiffuseForm::AmbientOcclusion => codes::DIFFUSE_AMBIENT_OCCLUSION,
                DiffuseForm::Directional => codes::DIFFUSE_DIRECTIONAL,
            },
            shade_at: match options.shade_at {
                ShadeAt::Pixel => codes::SHADE_AT_PIXEL,
                ShadeAt::Gaussian => codes::SHADE_AT_GAUSSIAN,
            },
            srgb: u32::from(options.srgb),
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
    /// Groups of the G-buffer gradient of a lit pass.
    n_groups: u32,
    pad: u32,
}

impl CompositeUniform {
    /// For the radiance branch alone.
    fn new(view: &CameraUniform, [r, g, b]: [f32; 3]) -> Self {
        let background = [r, g, b, 0.0];
        Self { background, n_pixels: view.n_pixels, srgb: 0, n_groups: 0, pad: 0 }
    }

    fn lit(job: &ShadeJob<'_>, n_groups: u32) -> Self {
        let ShadingUniform { background, srgb, .. } = *job.shading;
        Self { background, n_pixels: job.view.n_pixels, srgb, n_groups, pad: 0 }
    }
}

/// One image a branch, or their gradients: rgb a pixel, the fourth member unused.
#[derive(Debug, Clone)]
pub struct Images {
    /// Physically based branch, display-referred.
    pub physical: Buffer<[f32; 4]>,
    /// Radiance branch, display-referred.
    pub radiance: Buffer<[f32; 4]>,
}

impl Images {
    /// Room for both branches of `pixels` pixels.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] with the numbers, [`GpuError::OutOfMemory`].
    pub fn new(gpu: &Gpu, pixels: usize) -> Result<Self, GpuError> {
        Ok(Self {
            physical: gpu.buffer("the physical image", pixels)?,
            radiance: gpu.buffer("the radiance image", pixels)?,
        })
    }
}

/// How surfaces are shaded, and under which light.
#[derive(Debug, Clone, Copy)]
pub struct ShadeJob<'a> {
    /// The camera.
    pub view: &'a CameraUniform,
    /// The forward model.
    pub shading: &'a ShadingUniform,
    /// Visibility coefficients the surfaces carry: (order + 1)^2 for orders 0 to 6.
    pub n_visibility: usize,
    /// Tables of the light.
    pub light: &'a LightBuffers,
    /// Tables of the reflectance model.
    pub constants: &'a Constants,
}

/// One shader a number of visibility coefficients; `None` for what no field has.
pub(super) fn by_coefficients(
    n_visibility: usize,
    shaders: [&'static Shader; 7],
) -> Result<&'static Shader, GpuError> {
    let order = (0..7).find(|order| (order + 1) * (order + 1) == n_visibility);
    order
        .map(|order| shaders[order])
        .ok_or_else(|| GpuError::Internal(format!("no kernel for {n_visibility} visibility coefficients")))
}

impl ShadeJob<'_> {
    /// The first six bindings of everything that shades, then those given.
    pub(super) fn dispatch(
        &self,
        recorder: &mut Recorder<'_>,
        shader: &'static Shader,
        groups: Groups,
        rest: Vec<crate::engine::gpu::Bind<'_>>,
    ) {
        let mut bindings = vec![
            uniform(self.view),
            uniform(self.shading),
            uniform(&self.light.layout),
            (&self.constants.buffer).into(),
            (&self.light.values).into(),
            (&self.light.values).into(),
        ];
        bindings.extend(rest);
        recorder.dispatch(shader, groups, &bindings);
    }

    /// One workgroup of 16 x 16 a tile.
    pub(super) fn tiles(&self) -> Groups {
        Groups::Grid(self.view.tiles[0], self.view.tiles[1])
    }
}

/// Shades every pixel of a full G-buffer, `[group][pixel]`, and composites both branches over the background.
///
/// # Errors
/// When there is no kernel for the number of visibility coefficients.
pub fn shade(
    recorder: &mut Recorder<'_>,
    job: &ShadeJob<'_>,
    gbuffer: &Buffer<[f32; 4]>,
    images: &Images,
) -> Result<(), GpuError> {
    use shaders::*;
    let all = [&SHADE_1, &SHADE_4, &SHADE_9, &SHADE_16, &SHADE_25, &SHADE_36, &SHADE_49];
    let shader = by_coefficients(job.n_visibility, all)?;
    let rest = vec![gbuffer.into(), (&images.physical).into(), (&images.radiance).into()];
    job.dispatch(recorder, shader, job.tiles(), rest);
    Ok(())
}

/// What [`shade_backward`] is given and where it writes.
#[derive(Debug, Clone, Copy)]
pub struct ShadeGradients<'a> {
    /// The full G-buffer that was shaded.
    pub gbuffer: &'a Buffer<[f32; 4]>,
    /// Gradient by both images.
    pub by_images: &'a Images,
    /// Gradient by the buffers themselves (`losses::surface_terms`), two vec4 a pixel, planar.
    pub by_buffers: &'a Buffer<[f32; 4]>,
    /// Written: gradient by the G-buffer, `[group][pixel]`; four groups, or all of them if `all_channels`.
    pub by_gbuffer: &'a Buffer<[f32; 4]>,
    /// Added to: gradient by the light tables, laid out as they are. The caller clears it.
    pub by_tables: &'a Buffer<f32>,
    /// Differentiate indirect light and visibility too, not only the channels of `Material`.
    pub all_channels: bool,
}

/// Gradients of the G-buffer and of the light tables.
///
/// # Errors
/// When there is no kernel for the number of visibility coefficients.
pub fn shade_backward(
    recorder: &mut Recorder<'_>,
    job: &ShadeJob<'_>,
    gradients: &ShadeGradients<'_>,
) -> Result<(), GpuError> {
    use shaders::*;
    let all = if gradients.all_channels {
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
    let shader = by_coefficients(job.n_visibility, all)?;
    let rest = vec![
        gradients.gbuffer.into(),
        (&gradients.by_images.physical).into(),
        (&gradients.by_images.radiance).into(),
        gradients.by_buffers.into(),
        gradients.by_gbuffer.into(),
        gradients.by_tables.into(),
    ];
    job.dispatch(recorder, shader, job.tiles(), rest);
    Ok(())
}

/// Both branches of a pass of lit Gaussians, composited over the background.
pub fn show_lit(
    recorder: &mut Recorder<'_>,
    job: &ShadeJob<'_>,
    gbuffer: &Buffer<[f32; 4]>,
    images: &Images,
) {
    let composite = CompositeUniform::lit(job, 0);
    let bindings =
        [uniform(&composite), gbuffer.into(), (&images.physical).into(), (&images.radiance).into()];
    recorder.dispatch(&shaders::LIT, Groups::Linear(job.view.pixels()), &bindings);
}

/// Backward of [`show_lit`]: gradients of the G-buffer, of as many groups as were blended; none of the light tables, which
/// get theirs at the Gaussians.
pub fn show_lit_backward(recorder: &mut Recorder<'_>, job: &ShadeJob<'_>, gradients: &ShadeGradients<'_>) {
    let n_groups = if gradients.all_channels { groups(Channels::Full(job.n_visibility)) } else { 4 };
    let composite = CompositeUniform::lit(job, n_groups as u32);
    let bindings = [
        uniform(&composite),
        gradients.gbuffer.into(),
        (&gradients.by_images.physical).into(),
        (&gradients.by_images.radiance).into(),
        gradients.by_buffers.into(),
        gradients.by_gbuffer.into(),
    ];
    recorder.dispatch(&shaders::LIT_BACKWARD, Groups::Linear(job.view.pixels()), &bindings);
}

/// The radiance branch alone, for passes that carry no material.
pub fn radiance_image(
    recorder: &mut Recorder<'_>,
    view: &CameraUniform,
    background: [f32; 3],
    gbuffer: &Buffer<[f32; 4]>,
    radiance: &Buffer<[f32; 4]>,
) {
    let composite = CompositeUniform::new(view, background);
    let bindings = [uniform(&composite), gbuffer.into(), radiance.into()];
    recorder.dispatch(&shaders::RADIANCE, Groups::Linear(view.pixels()), &bindings);
}

/// Backward of [`radiance_image`] with the gradients by the buffers: writes one group of the G-buffer gradient, or two
/// for any `channels` beyond `Colour`.
pub fn radiance_image_backward(
    recorder: &mut Recorder<'_>,
    view: &CameraUniform,
    background: [f32; 3],
    by_radiance: &Buffer<[f32; 4]>,
    by_buffers: &Buffer<[f32; 4]>,
    by_gbuffer: &Buffer<[f32; 4]>,
    channels: Channels,
) {
    let composite = CompositeUniform::new(view, background);
    let shader = match channels {
        Channels::Colour => &shaders::RADIANCE_BACKWARD,
        _ => &shaders::RADIANCE_GEOMETRY_BACKWARD,
    };
    let bindings = [uniform(&composite), by_radiance.into(), by_buffers.into(), by_gbuffer.into()];
    recorder.dispatch(shader, Groups::Linear(view.pixels()), &bindings);
}
