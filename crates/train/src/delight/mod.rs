//! Photographs without their light: albedo, shading, shadow and specular layers at the size of the photographs (docs/MODEL.md, section 11).
//!
//! A model separates the light of a photograph from the colour of the surface. The Gaussians limit the detail of its albedo; the photograph
//! has finer detail.
//! [`Delighter`] renders the model's layers for the camera of a photograph, and transfers the detail of the photograph to the albedo.

mod detail;
mod exposure;
mod files;

use std::sync::Arc;

use crate::eval::light_of;
use crate::render::{Frame, RenderError, Renderer, RotatedLight};
use relume_capture::CaptureView;
use relume_engine::{Device, DeviceError};
use relume_scene::{IndirectForm, Model, VisibilityForm};
use relume_spec::rendering::{Output, Tier};

pub use detail::DetailTransfer;
pub use files::{file_stems, layer_path, layers_of};

/// Share of a diffuse surface below which shading cannot be divided by it: metal and black.
const MIN_REFLECTANCE: f32 = 0.02;
/// Planes of the model that are compared with a photograph.
const PLANES: [Output; 5] =
    [Output::Albedo, Output::Metallic, Output::Diffuse, Output::Specular, Output::Alpha];

/// The layers of one photograph. All are row-major planes of its size, in linear light and not premultiplied; a pixel that the model does
/// not cover has zeros.
#[derive(Debug, Clone, PartialEq)]
pub struct DelitPhotograph {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Albedo with the detail of the photograph.
    pub albedo: Vec<[f32; 3]>,
    /// Albedo of the model.
    pub model_albedo: Vec<[f32; 3]>,
    /// What a white diffuse surface would reflect at this point, as the model finds it.
    pub shading: Vec<[f32; 3]>,
    /// Shading divided by shading without occlusion and without light from other surfaces. Above 1 where the light from other surfaces
    /// exceeds the occluded light.
    pub shadow: Vec<[f32; 3]>,
    /// Specular reflection.
    pub specular: Vec<[f32; 3]>,
    /// Coverage by the model and by the mask of the photograph, 0 to 1.
    pub alpha: Vec<f32>,
}

/// Separates photographs into layers by a model.
pub struct Delighter {
    renderer: Renderer,
    light: RotatedLight,
    /// The model without occlusion, and its light.
    open: Renderer,
    open_light: RotatedLight,
    /// Longest side of the photographs in the training, pixels; `None` if the card does not have it.
    trained_side: Option<f32>,
}

impl Delighter {
    /// Prepares a checked model with materials on `device`.
    ///
    /// # Errors
    /// If the device cannot hold the model.
    pub fn new(model: Arc<Model>, device: &Device) -> Result<Self, DeviceError> {
        let trained_side = model.card.pointer("/config/resolution").and_then(serde_json::Value::as_f64);
        let mut open = Model::clone(&model);
        open.shading.visibility = VisibilityForm::Off;
        open.shading.indirect = IndirectForm::Off;
        Ok(Self {
            renderer: Renderer::on(model, device)?,
            light: RotatedLight::default(),
            open: Renderer::on(Arc::new(open), device)?,
            open_light: RotatedLight::default(),
            trained_side: trained_side.map(|side| side as f32),
        })
    }

    /// The layers of a photograph of the model's capture, under the recovered light of its light group.
    ///
    /// # Errors
    /// Names the camera field that cannot be rendered, says that the photograph does not have the size of its camera, or that the device
    /// failed.
    pub fn delight(&mut self, view: &CaptureView) -> Result<DelitPhotograph, RenderError> {
        if view.image.len() != view.camera.width as usize * view.camera.height as usize {
            let reason = format!("{} has another size than its camera", view.name);
            return Err(RenderError::Refused { field: "photograph", reason });
        }
        let light = light_of(&self.renderer, view, &mut self.light)?;
        let frame = self.renderer.render(&view.camera, light, Tier::Standard, &PLANES)?;
        let light = light_of(&self.open, view, &mut self.open_light)?;
        let open = self.open.render(&view.camera, light, Tier::Standard, &[Output::Diffuse])?;
        let surfaces = Surfaces::of(&frame, &open);
        drop((frame, open));
        let photograph = exposure::matched(view, &surfaces);
        let enlargement =
            view.camera.width.max(view.camera.height) as f32 / self.trained_side.unwrap_or(f32::MAX);
        let albedo = DetailTransfer::enlarged(enlargement).albedo(&photograph, &surfaces);
        let alpha =
            surfaces.alpha.iter().zip(view.image.alpha()).map(|(model, mask)| model.min(mask)).collect();
        let Surfaces { width, height, albedo: model_albedo, shading, shadow, specular, .. } = surfaces;
        Ok(DelitPhotograph { width, height, albedo, model_albedo, shading, shadow, specular, alpha })
    }
}

/// The layers that a model has for a photograph, not premultiplied.
struct Surfaces {
    width: u32,
    height: u32,
    albedo: Vec<[f32; 3]>,
    metal: Vec<f32>,
    diffuse: Vec<[f32; 3]>,
    specular: Vec<[f32; 3]>,
    shading: Vec<[f32; 3]>,
    shadow: Vec<[f32; 3]>,
    alpha: Vec<f32>,
}

impl Surfaces {
    fn of(frame: &Frame, open: &Frame) -> Self {
        let alpha = scalars(frame, Output::Alpha);
        let metal = scalars(frame, Output::Metallic);
        let albedo = colours(frame, Output::Albedo);
        let straight = |values: Vec<[f32; 3]>| -> Vec<[f32; 3]> {
            let pixel = |(v, a): (&[f32; 3], &f32)| if *a > 1e-3 { v.map(|v| v / a) } else { [0.0; 3] };
            values.iter().zip(&alpha).map(pixel).collect()
        };
        let diffuse = straight(colours(frame, Output::Diffuse));
        let without_occlusion = straight(colours(open, Output::Diffuse));
        let shading = |i: usize| {
            let reflectance = |c: usize| (albedo[i][c] * (1.0 - metal[i])).max(MIN_REFLECTANCE);
            std::array::from_fn(|c| diffuse[i][c] / reflectance(c))
        };
        let shadow = |i: usize| std::array::from_fn(|c| diffuse[i][c] / without_occlusion[i][c].max(1e-6));
        Self {
            width: frame.width,
            height: frame.height,
            shading: (0..alpha.len()).map(shading).collect(),
            shadow: (0..alpha.len()).map(shadow).collect(),
            specular: straight(colours(frame, Output::Specular)),
            albedo,
            metal,
            diffuse,
            alpha,
        }
    }

    /// What pixel `i` reflects in proportion to its albedo, and the rest.
    fn reflected(&self, i: usize) -> ([f32; 3], [f32; 3]) {
        let by_albedo = |c: usize| self.diffuse[i][c] + self.metal[i] * self.specular[i][c];
        let rest = |c: usize| (1.0 - self.metal[i]) * self.specular[i][c];
        (std::array::from_fn(by_albedo), std::array::from_fn(rest))
    }
}

fn scalars(frame: &Frame, output: Output) -> Vec<f32> {
    frame.planes.get(&output).cloned().unwrap_or_default()
}

fn colours(frame: &Frame, output: Output) -> Vec<[f32; 3]> {
    frame.planes.get(&output).map(|plane| plane.as_chunks::<3>().0.to_vec()).unwrap_or_default()
}
