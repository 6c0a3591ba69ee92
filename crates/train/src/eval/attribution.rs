//! Attributes the error of relit images to the layers of a model: the error that remains when ground truth replaces a
//! layer comes from the other layers.

use std::sync::Arc;

use crate::eval::evaluate::{EvalError, check_sizes, evenly_spaced, lights_of, refused};
use crate::eval::image::{mean_squared_error, psnr_of};
use crate::eval::totals::Mean;
use crate::eval::views::{on_white, photograph};
use crate::render::{Frame, Renderer};
use relume_capture::{Capture, CaptureView};
use relume_engine::{Surface, SurfaceShader};
use relume_scene::Model;
use relume_spec::rendering::Output;

/// A layer that ground truth can replace.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TruthLayer {
    /// Linear base colour.
    Albedo,
    /// Shading normal.
    Normal,
    /// Metalness and roughness.
    Material,
    /// Visibility, scaled so that its ambient occlusion is that of the ground truth; gathered radiance from blocked
    /// directions is scaled accordingly.
    Occlusion,
    /// Silhouette: the alpha channel.
    Alpha,
}

/// Relit PSNR of `model` in dB for each set of layers in `replacements`: mean over `capture`'s lights of the mean
/// over its views (at most `views`). Layers without ground truth stay those of the model. `None` without relit ground
/// truth. Surfaces are always shaded per pixel, because the ground truth is known per pixel. A model that is shaded
/// at its Gaussians therefore has another PSNR here than in [`crate::eval::evaluate()`], even without replacements.
///
/// # Errors
/// Names the view and layer whose size differs from that of its camera; otherwise the renderer's error.
pub fn attribute(
    model: &Arc<Model>,
    capture: &Capture,
    views: Option<usize>,
    replacements: &[&[TruthLayer]],
) -> Result<Vec<Option<f64>>, EvalError> {
    let views = evenly_spaced(&capture.test, views);
    views.iter().try_for_each(|view| check_sizes(view))?;
    let lights = lights_of(&views, capture);
    let renderer = Renderer::new(model.clone());
    let mut means = vec![Mean::default(); replacements.len()];
    for name in &lights {
        let light = renderer.prepare_light(&capture.lights[*name])?;
        let mut of_light = vec![Mean::default(); replacements.len()];
        for view in &views {
            let Some(truth) = view.truth.relit.get(*name) else { continue };
            let truth = photograph(truth);
            for (mean, replaced) in of_light.iter_mut().zip(replacements) {
                let edit = |shader: &SurfaceShader<'_>, i: usize, surface: &mut Surface| {
                    put_truth(view, replaced, shader, i, surface);
                };
                let mut frame = renderer
                    .render_edited(&view.camera, &light, &edit)
                    .map_err(|source| refused(view, source))?;
                if replaced.contains(&TruthLayer::Alpha) {
                    set_alpha(&mut frame, view);
                }
                let picture = on_white(&frame, Output::Rgb);
                mean.add(Some(psnr_of(mean_squared_error(&picture.values, &truth.values))));
            }
        }
        means.iter_mut().zip(of_light).for_each(|(mean, of_light)| mean.add(of_light.value()));
    }
    Ok(means.into_iter().map(|mean| mean.value()).collect())
}

/// Replaces the given layers of pixel `i` where the photograph has foreground.
fn put_truth(
    view: &CaptureView,
    replaced: &[TruthLayer],
    shader: &SurfaceShader<'_>,
    i: usize,
    surface: &mut Surface,
) {
    let truth = &view.truth;
    let replaces = |layer| replaced.contains(&layer);
    if view.image.pixel(i)[3] < 0.5 {
        return;
    }
    if let (true, Some(occlusion)) = (replaces(TruthLayer::Occlusion), &truth.ambient_occlusion) {
        let wanted = occlusion.values[i][0].clamp(0.0, 1.0);
        let normal = truth.normal.as_ref().map_or(surface.normal, |n| n.values[i]);
        let found = shader.ambient_occlusion(&surface.visibility, normal).clamp(0.02, 1.0);
        surface.visibility.iter_mut().for_each(|c| *c *= wanted / found);
        let blocked = ((1.0 - wanted) / (1.0 - found).max(0.02)).min(10.0);
        surface.gathered.iter_mut().for_each(|e| *e *= blocked);
    }
    if let (true, Some(albedo)) = (replaces(TruthLayer::Albedo), &truth.albedo) {
        surface.albedo = albedo.values[i];
    }
    if let (true, Some(normal)) = (replaces(TruthLayer::Normal), &truth.normal) {
        surface.normal = normal.values[i];
    }
    if let (true, Some(material)) = (replaces(TruthLayer::Material), &truth.metallic_roughness) {
        [surface.metal, surface.rough] = material.values[i];
    }
}

/// Replaces the alpha channel of the frame with the alpha channel of the photograph. Colours are premultiplied.
fn set_alpha(frame: &mut Frame, view: &CaptureView) {
    let found = frame.planes.get(&Output::Alpha).cloned().unwrap_or_default();
    let wanted: Vec<f32> = view.image.alpha();
    if let Some(colour) = frame.planes.get_mut(&Output::Rgb) {
        for ((pixel, found), wanted) in colour.chunks_exact_mut(3).zip(&found).zip(&wanted) {
            pixel.iter_mut().for_each(|c| *c *= wanted / found.max(1e-3));
        }
    }
    frame.planes.insert(Output::Alpha, wanted);
}
