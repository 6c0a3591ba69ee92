//! The contact sheet of an evaluation.

use std::sync::Arc;

use crate::eval::evaluate::{EvalError, evenly_spaced, lights_of, refused};
use crate::eval::image::DisplayImage;
use crate::eval::sheet::{Sheet, error_map, grey};
use crate::eval::views::{ViewLayers, light_of, photograph, relit, shown_by};
use crate::render::{PreparedLight, Renderer, RotatedLight};
use relume_capture::{Capture, CaptureView};
use relume_engine::Device;
use relume_scene::{Model, Plane, srgb};
use relume_spec::rendering::Quality;

/// Draws a sheet of `rows` test views, evenly spaced: photograph, both branches, each light next to its ground truth,
/// albedo, normal, roughness and ambient occlusion next to theirs, and the error of the novel view.
///
/// # Errors
/// [`EvalError`] if there are no test views or one cannot be rendered.
pub fn contact_sheet(
    model: Arc<Model>,
    capture: &Capture,
    quality: impl Into<Quality>,
    rows: usize,
    device: &Device,
) -> Result<Sheet, EvalError> {
    let quality = quality.into();
    let views = evenly_spaced(&capture.test, Some(rows));
    if views.is_empty() {
        return Err(EvalError::NoTestViews);
    }
    let lights = lights_of(&views, capture);
    let renderer = Renderer::on(model, device)?;
    let mut own = RotatedLight::default();
    let mut prepared: Vec<(&str, PreparedLight)> = Vec::with_capacity(lights.len());
    for name in &lights {
        prepared.push((*name, renderer.prepare_light(&capture.lights[*name])?));
    }
    let mut sheet = Sheet::new(column_names(&lights));
    for view in views {
        let light = light_of(&renderer, view, &mut own)?;
        let layers = ViewLayers::render(&renderer, &view.camera, light, quality)
            .map_err(|source| refused(view, source))?;
        let mut cells = vec![
            Some(photograph(&view.image.decoded())),
            Some(layers.shaded.clone()),
            Some(layers.radiance.clone()),
        ];
        for (name, light) in &prepared {
            let picture =
                relit(&renderer, &view.camera, light, quality).map_err(|source| refused(view, source))?;
            cells.extend([Some(picture), view.truth.relit.get(*name).map(photograph)]);
        }
        cells.extend(layer_cells(renderer.model(), &layers, view));
        sheet.push(view.name.clone(), cells);
    }
    Ok(sheet)
}

fn column_names(lights: &[&str]) -> Vec<String> {
    let mut names = ["photograph", "novel view", "radiance"].map(str::to_owned).to_vec();
    names.extend(lights.iter().flat_map(|light| [(*light).to_owned(), format!("{light} truth")]));
    let layers =
        ["albedo", "albedo truth", "normal", "normal truth", "roughness", "ao", "ao truth", "error x4"];
    names.extend(layers.map(str::to_owned));
    names
}

fn layer_cells(model: &Model, layers: &ViewLayers, view: &CaptureView) -> [Option<DisplayImage>; 8] {
    let (width, height) = (view.camera.width, view.camera.height);
    let picture = |values: Vec<[f32; 3]>| on_white(&Plane { width, height, values }, &layers.alpha);
    let one = |values: &[f32]| on_white(&grey(width, height, values.iter().copied()), &layers.alpha);
    let [albedo, normal, _, visibility] = truth_layers(view);
    [
        Some(picture(layers.albedo.iter().map(shown_colour).collect())),
        albedo,
        Some(picture(layers.normal.iter().map(shown_normal).collect())),
        normal,
        Some(one(&layers.roughness)),
        Some(one(&layers.visibility)),
        visibility,
        Some(error_map(&layers.shaded, &shown_by(model, view, &layers.alpha))),
    ]
}

/// A view's ground-truth albedo (sRGB curve), normal (`n / 2 + 1 / 2`), roughness and ambient occlusion, on white;
/// `None` for layers that the view lacks.
pub fn truth_layers(view: &CaptureView) -> [Option<DisplayImage>; 4] {
    let (width, height, alpha) = (view.image.width, view.image.height, view.image.alpha());
    let truth = &view.truth;
    let colours = |p: &Plane<3>, shown: fn(&[f32; 3]) -> [f32; 3]| {
        let values = p.values.iter().map(shown).collect();
        on_white(&Plane { width, height, values }, &alpha)
    };
    let roughness = |p: &Plane<2>| on_white(&grey(width, height, p.values.iter().map(|v| v[1])), &alpha);
    let open = |p: &Plane<1>| on_white(&grey(width, height, p.values.iter().map(|v| v[0])), &alpha);
    [
        truth.albedo.as_ref().map(|p| colours(p, shown_colour)),
        truth.normal.as_ref().map(|p| colours(p, shown_normal)),
        truth.metallic_roughness.as_ref().map(roughness),
        truth.ambient_occlusion.as_ref().map(open),
    ]
}

fn shown_colour(linear: &[f32; 3]) -> [f32; 3] {
    linear.map(srgb::encode)
}

fn shown_normal(n: &[f32; 3]) -> [f32; 3] {
    n.map(|v| 0.5 * v + 0.5)
}

fn on_white(picture: &DisplayImage, alpha: &[f32]) -> DisplayImage {
    let pixel = |(c, a): (&[f32; 3], &f32)| c.map(|v| v * a + 1.0 - a);
    Plane { values: picture.values.iter().zip(alpha).map(pixel).collect(), ..*picture }
}
