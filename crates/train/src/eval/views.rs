//! A model's renderings of one test view, as images and layers that are compared with ground truth.

use crate::eval::image::DisplayImage;
use crate::render::{Frame, PreparedLight, RenderError, Renderer, RotatedLight};
use relume_capture::CaptureView;
use relume_engine::DeviceError;
use relume_scene::{Camera, ImageRgba, Model, PackedImage, Plane, srgb};
use relume_spec::rendering::{Output, Quality};

/// A test view under the model's recovered light, with every layer for which ground truth may exist.
pub(crate) struct ViewLayers {
    /// The physically based branch on white, display-referred.
    pub(crate) shaded: DisplayImage,
    /// The radiance branch on white, display-referred.
    pub(crate) radiance: DisplayImage,
    pub(crate) alpha: Vec<f32>,
    pub(crate) albedo: Vec<[f32; 3]>,
    pub(crate) normal: Vec<[f32; 3]>,
    pub(crate) metallic: Vec<f32>,
    pub(crate) roughness: Vec<f32>,
    pub(crate) visibility: Vec<f32>,
    pub(crate) depth: Vec<f32>,
}

const LAYERS: [Output; 8] = [
    Output::Rgb,
    Output::Radiance,
    Output::Albedo,
    Output::Normal,
    Output::Metallic,
    Output::Roughness,
    Output::Visibility,
    Output::Depth,
];

/// The recovered light of a model for the light group of `view`, rotated as in `view`. A view of an unknown group has the first light.
///
/// # Errors
/// The device failed.
pub(crate) fn light_of<'a>(
    renderer: &Renderer,
    view: &CaptureView,
    light: &'a mut RotatedLight,
) -> Result<&'a PreparedLight, DeviceError> {
    let group = renderer.model().light_group(view.light_group.as_deref().unwrap_or_default());
    light.recovered(renderer, group.unwrap_or(0), view.light_rotation_deg)
}

impl ViewLayers {
    /// Renders all layers of `camera`'s view under `light`.
    ///
    /// # Errors
    /// The renderer's error.
    pub(crate) fn render(
        renderer: &Renderer,
        camera: &Camera,
        light: &PreparedLight,
        quality: Quality,
    ) -> Result<Self, RenderError> {
        let frame = renderer.render(camera, light, quality, &LAYERS)?;
        Ok(Self {
            shaded: on_white(&frame, Output::Rgb),
            radiance: on_white(&frame, Output::Radiance),
            albedo: colours(&frame, Output::Albedo),
            normal: colours(&frame, Output::Normal),
            metallic: scalars(&frame, Output::Metallic),
            roughness: scalars(&frame, Output::Roughness),
            visibility: scalars(&frame, Output::Visibility),
            depth: scalars(&frame, Output::Depth),
            alpha: scalars(&frame, Output::Alpha),
        })
    }
}

/// The relit image of a view on white, display-referred.
///
/// # Errors
/// The renderer's error.
pub(crate) fn relit(
    renderer: &Renderer,
    camera: &Camera,
    light: &PreparedLight,
    quality: Quality,
) -> Result<DisplayImage, RenderError> {
    Ok(on_white(&renderer.render(camera, light, quality, &[Output::Rgb])?, Output::Rgb))
}

/// A premultiplied linear colour plane, composited on white *after* the display curve, like photographs with straight
/// alpha: `srgb(clamp(rgb / alpha)) * alpha + 1 - alpha`.
pub fn on_white(frame: &Frame, output: Output) -> DisplayImage {
    let alpha = scalars(frame, Output::Alpha);
    let pixel = |(c, a): (&[f32; 3], &f32)| {
        let a = a.clamp(0.0, 1.0);
        c.map(|v| srgb::encode(v / a.max(1e-6)) * a + 1.0 - a)
    };
    let values = colours(frame, output).iter().zip(&alpha).map(pixel).collect();
    Plane { width: frame.width, height: frame.height, values }
}

fn scalars(frame: &Frame, output: Output) -> Vec<f32> {
    frame.planes.get(&output).cloned().unwrap_or_default()
}

fn colours(frame: &Frame, output: Output) -> Vec<[f32; 3]> {
    frame.planes.get(&output).map(|p| p.as_chunks::<3>().0.to_vec()).unwrap_or_default()
}

/// A photograph or relit ground truth on white, display-referred.
pub fn photograph(image: &ImageRgba) -> DisplayImage {
    Plane { width: image.width, height: image.height, values: image.over([1.0; 3]) }
}

/// The part of a photograph that `model` represents, on white and clipped at 1, as the model's images are: for a model with a
/// crop, the part that its `alpha` covers.
pub(crate) fn shown_by(model: &Model, view: &CaptureView, alpha: &[f32]) -> DisplayImage {
    shown_part(model, photograph(&view.image.shown()), alpha)
}

/// The part of a photograph on white that `model` represents, as [`shown_by`]. `alpha` has the size of the photograph.
pub(crate) fn shown_part(model: &Model, photograph: DisplayImage, alpha: &[f32]) -> DisplayImage {
    if is_cropped(model) { covered(photograph, alpha) } else { photograph }
}

/// The part of an image that `alpha` covers, on white.
fn covered(picture: DisplayImage, alpha: &[f32]) -> DisplayImage {
    let pixel = |(p, a): (&[f32; 3], &f32)| p.map(|v| v * a + 1.0 - a);
    let values = picture.values.iter().zip(alpha).map(pixel).collect();
    Plane { values, ..picture }
}

/// Whether the model has a crop of photographs without masks.
pub(crate) fn is_cropped(model: &Model) -> bool {
    model.card.get("crop").is_some_and(|region| !region.is_null())
}

/// Foreground of the ground truth: alpha above one half.
pub(crate) fn foreground(image: &PackedImage) -> Vec<bool> {
    image.pixels().map(|p| p[3] > 0.5).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one_pixel(rgb: [f32; 3], alpha: f32) -> Frame {
        let planes = [(Output::Rgb, rgb.to_vec()), (Output::Alpha, vec![alpha])].into();
        Frame { width: 1, height: 1, planes }
    }

    #[test]
    fn tone_curve_is_applied_before_compositing_on_white() {
        // Linear 0.25 at half coverage: premultiplied 0.125.
        let shown = on_white(&one_pixel([0.125; 3], 0.5), Output::Rgb).values[0][0];
        assert!((shown - (0.5 * srgb::encode(0.25) + 0.5)).abs() < 1e-6);
        // Negative control: blending in linear light first gives another value.
        assert!((shown - srgb::encode(0.125 + 0.5)).abs() > 0.02);
    }

    #[test]
    fn empty_pixels_are_white_and_overexposed_ones_are_clamped() {
        assert_eq!(on_white(&one_pixel([0.0; 3], 0.0), Output::Rgb).values[0], [1.0; 3]);
        assert_eq!(on_white(&one_pixel([7.0; 3], 1.0), Output::Rgb).values[0], [1.0; 3]);
    }

    #[test]
    fn uncovered_parts_of_a_photograph_are_white() {
        let picture = Plane { width: 3, height: 1, values: vec![[0.2, 0.4, 0.6]; 3] };
        let shown = covered(picture, &[0.0, 0.5, 1.0]).values;
        for (found, expected) in shown.iter().flatten().zip([1.0, 1.0, 1.0, 0.6, 0.7, 0.8, 0.2, 0.4, 0.6]) {
            assert!((found - expected).abs() < 1e-6, "{shown:?}");
        }
    }
}
