//! Terms of the objective on images and buffers (docs/MODEL.md, section 5): absolute error and SSIM of an image, and
//! coverage, depth-normal consistency and smoothness of a G-buffer.

use bytemuck::{Pod, Zeroable};

use crate::gpu::{Buffer, CameraUniform, DevicePhoto, Recorder, shaders, uniform};
use crate::{ImageWeights, StepWeights, SurfaceWeights};
use relume_layout::channel::Channels;
use relume_scene::DisplayRange;

#[cfg(test)]
mod tests;

pub use relume_layout::kernel_constants::{LOSS_SLOTS, LossSlot};

/// `ImageTerm` of `shaders/shared/ssim_window.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct ImageTermUniform {
    size: [u32; 2],
    first_slot: u32,
    scale: f32,
    l1: f32,
    ssim: f32,
    /// Colour of the highest level of the photograph.
    photo_white: f32,
    pad: u32,
}

/// One branch's image term `l1 mean |I - photo| + ssim (1 - SSIM)` (Eq. 30).
#[derive(Debug, Clone, Copy)]
pub struct ImageTerm<'a> {
    /// Image size.
    pub camera: &'a CameraUniform,
    /// The rendered image, rgb.
    pub image: &'a Buffer<[f32; 4]>,
    /// The photograph, rgb and mask.
    pub photo: &'a DevicePhoto,
    /// The first of the branch's three slots: `PhysicalL1` or `RadianceL1`.
    pub slot: LossSlot,
    /// Weights of its two parts.
    pub weights: ImageWeights,
    /// Scratch of three elements per pixel; both branches can share it.
    pub partials: &'a Buffer<[f32; 4]>,
}

impl ImageTerm<'_> {
    /// Adds the means to the branch's slots of `losses` and writes the gradient by the image to `by_image`.
    pub fn record(&self, recorder: &mut Recorder<'_>, by_image: &Buffer<[f32; 4]>, losses: &Buffer<f32>) {
        let term = ImageTermUniform {
            size: self.camera.size,
            first_slot: self.slot as u32,
            scale: 1.0 / (3 * self.camera.n_pixels).max(1) as f32,
            l1: self.weights.l1,
            ssim: self.weights.ssim,
            photo_white: self.photo.range.white(),
            pad: 0,
        };
        let groups = self.camera.tile_groups();
        let bindings = [
            uniform(&term),
            self.image.into(),
            (&self.photo.pixels).into(),
            self.partials.into(),
            losses.into(),
        ];
        recorder.dispatch(&shaders::SSIM, groups, &bindings);
        let bindings = [
            uniform(&term),
            self.image.into(),
            (&self.photo.pixels).into(),
            self.partials.into(),
            by_image.into(),
        ];
        recorder.dispatch(&shaders::SSIM_BACKWARD, groups, &bindings);
    }
}

/// `SurfaceTerms` of `shaders/surface_terms.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct SurfaceTermsUniform {
    coverage: f32,
    depth_normal: f32,
    /// 1 / number of horizontal neighbour pairs; the next member is the same for vertical pairs.
    across: f32,
    down: f32,
    /// Weights of smoothness: metalness, roughness, each channel of the normal.
    smoothness: [f32; 3],
    /// Colour of the highest level of the photograph.
    photo_white: f32,
}

impl SurfaceTermsUniform {
    fn new(weights: &SurfaceWeights, [w, h]: [u32; 2], range: DisplayRange) -> Self {
        let [metal, rough, normal] = weights.smoothness;
        let share = |weight: f32, count: u32| if w < 2 || h < 2 { 0.0 } else { weight / count as f32 };
        Self {
            coverage: weights.coverage / (w * h).max(1) as f32,
            depth_normal: share(weights.depth_normal, w * h),
            across: share(1.0, w.saturating_sub(1) * h),
            down: share(1.0, w * h.saturating_sub(1)),
            smoothness: [metal, rough, normal / 3.0],
            photo_white: range.white(),
        }
    }
}

/// Adds the values of the terms on a G-buffer of `channels` to `losses` and writes their gradient to `by_buffers`: two
/// elements per pixel, planar, (normal, plane distance) and (coverage, metalness, roughness, unused).
pub fn surface_terms(
    recorder: &mut Recorder<'_>,
    camera: &CameraUniform,
    channels: Channels,
    weights: &SurfaceWeights,
    photo: &DevicePhoto,
    [gbuffer, by_buffers]: [&Buffer<[f32; 4]>; 2],
    losses: &Buffer<f32>,
) {
    let kernel = match channels {
        Channels::Colour => &shaders::SURFACE_TERMS_COLOUR,
        Channels::Geometry => &shaders::SURFACE_TERMS_GEOMETRY,
        Channels::Material | Channels::Full(_) => &shaders::SURFACE_TERMS_MATERIAL,
    };
    let terms = SurfaceTermsUniform::new(weights, camera.size, photo.range);
    let bindings = [
        uniform(camera),
        uniform(&terms),
        gbuffer.into(),
        (&photo.pixels).into(),
        by_buffers.into(),
        losses.into(),
    ];
    recorder.dispatch(kernel, camera.tile_groups(), &bindings);
}

/// The objective from its loss slots.
pub fn objective(losses: &[f32], weights: &StepWeights) -> f32 {
    let at = |slot: LossSlot| losses[slot as usize];
    let image = |w: &ImageWeights, l1: LossSlot, ssim: LossSlot| w.l1 * at(l1) + w.ssim * (1.0 - at(ssim));
    let rest: f32 = losses[LossSlot::Coverage as usize..=LossSlot::Visibility as usize].iter().sum();
    rest + image(&weights.physical, LossSlot::PhysicalL1, LossSlot::PhysicalSsim)
        + image(&weights.radiance, LossSlot::RadianceL1, LossSlot::RadianceSsim)
}
