//! The contact sheet of a model.

use std::sync::Arc;

use crate::eval::cell::{at_cell_size, cell_size};
use crate::eval::evaluate::{EvalError, check_sizes, refused};
use crate::eval::exposure::matched;
use crate::eval::image::DisplayImage;
use crate::eval::sheet::{Column, Sheet};
use crate::eval::sheet_rows::SheetRows;
use crate::eval::views::{ViewLayers, light_of, photograph, relit, shown_part};
use crate::render::{PreparedLight, Renderer, RotatedLight};
use relume_capture::{CaptureView, builtin};
use relume_engine::Device;
use relume_scene::{EnvMap, Model, Plane, VisibilityForm, srgb};
use relume_spec::rendering::Quality;

/// Number of lights under which the views are relit.
const LIGHTS: usize = 2;
/// Built-in lights for captures without ground truth of relit views: a low sun, and lamps on three sides.
const BUILTIN_LIGHTS: [&str; LIGHTS] = ["sunset", "studio"];
/// Mean channel difference that is white in the error column.
const ERROR_WHITE: f32 = 0.25;

/// Draws a sheet with a row for each view: photograph, novel view, error, two relit views, albedo, normals, roughness
/// and ambient occlusion. A second row below has the ground truth if the view has it. The lights are those of the
/// ground truth, then built-in ones. Columns without data are left out: a model without materials shows its radiance
/// branch.
///
/// The model is rendered at the size of a cell, so that its pictures are never enlarged.
///
/// # Errors
/// [`EvalError`] if there are no views or one cannot be rendered.
pub fn contact_sheet(
    model: Arc<Model>,
    rows: &SheetRows,
    quality: impl Into<Quality>,
    device: &Device,
) -> Result<Sheet, EvalError> {
    if rows.rows.is_empty() {
        return Err(EvalError::NoTestViews);
    }
    let renderer = Renderer::on(model, device)?;
    let painter = RowPainter {
        lights: if renderer.model().has_materials() { prepared_lights(&renderer, rows)? } else { Vec::new() },
        renderer: &renderer,
        quality: quality.into(),
    };
    let mut sheet = Sheet::new(painter.columns());
    let mut own = RotatedLight::default();
    for (label, view) in &rows.rows {
        check_sizes(view)?;
        let light = light_of(&renderer, view, &mut own)?;
        let [own, truth] = painter.cells(view, light)?;
        sheet.push(label, own);
        if truth.iter().any(Option::is_some) {
            sheet.push(format!("{}, ground truth", view.name), truth);
        }
    }
    Ok(sheet)
}

/// A light with its name.
type NamedLight = (String, PreparedLight);

fn prepared_lights(renderer: &Renderer, rows: &SheetRows) -> Result<Vec<NamedLight>, EvalError> {
    let prepare = |(name, map): (String, EnvMap)| Ok((name, renderer.prepare_light(map)?));
    chosen_lights(rows).into_iter().map(prepare).collect()
}

/// The names and maps of the lights.
fn chosen_lights(rows: &SheetRows) -> Vec<(String, EnvMap)> {
    let has_truth = |name: &String| rows.rows.iter().any(|(_, view)| view.truth.relit.contains_key(name));
    let of_truth = rows.lights.iter().filter(|(name, _)| has_truth(name));
    let mut lights: Vec<_> = of_truth.map(|(name, map)| (name.clone(), map.clone())).take(LIGHTS).collect();
    for name in BUILTIN_LIGHTS {
        let is_new = lights.iter().all(|(other, _)| other != name);
        if let Some(map) = builtin(name).filter(|_| is_new && lights.len() < LIGHTS) {
            lights.push((name.to_owned(), map));
        }
    }
    lights
}

/// The pictures of a row, by column.
type Cells = Vec<Option<DisplayImage>>;

/// Draws the rows of a sheet for one model.
struct RowPainter<'a> {
    renderer: &'a Renderer,
    /// Empty for a model without materials.
    lights: Vec<NamedLight>,
    quality: Quality,
}

impl RowPainter<'_> {
    /// The labels of [`Self::cells`].
    fn columns(&self) -> Vec<Column> {
        let percent = |share: f32| format!("{:.0}", 100.0 * share * ERROR_WHITE);
        let scale =
            format!("red {}, yellow {}, white {} %", percent(1.0 / 3.0), percent(2.0 / 3.0), percent(1.0));
        let branch = match self.renderer.model().has_materials() {
            true => "light of the photographs",
            false => "radiance branch",
        };
        let mut columns = vec![
            Column::new("photograph", ""),
            Column::new("novel view", branch),
            Column::new("error", scale),
        ];
        columns.extend(self.lights.iter().map(|(name, _)| Column::new("relit", name)));
        let layers = ["albedo", "normals", "roughness", "ambient occlusion"];
        columns.extend(layers.map(|title| Column::new(title, "")));
        columns
    }

    /// The pictures of a view and its ground truth, all of the same size. The photograph is above the empty cells of the
    /// ground truth.
    fn cells(&self, view: &CaptureView, light: &PreparedLight) -> Result<[Cells; 2], EvalError> {
        let (width, height) = cell_size((view.image.width, view.image.height));
        let camera = view.camera.resized(width, height);
        let failed = |source| refused(view, source);
        let layers = ViewLayers::render(self.renderer, &camera, light, self.quality).map_err(failed)?;
        let has_materials = self.renderer.model().has_materials();
        let novel = if has_materials { &layers.shaded } else { &layers.radiance };
        let taken = photograph(&view.image.shown());
        let error = self.error(&taken, novel, &layers.alpha);
        let mut cells = vec![(Some(taken), None), (Some(novel.clone()), None), (Some(error), None)];
        for (name, light) in &self.lights {
            let picture = relit(self.renderer, &camera, light, self.quality).map_err(failed)?;
            cells.push((Some(picture), view.truth.relit.get(name).map(photograph)));
        }
        cells.extend(layer_cells(self.renderer.model(), &layers, view));
        let fitted = |picture: DisplayImage| at_cell_size(&picture, (width, height));
        let pairs = cells.into_iter().map(|(own, truth)| (own.map(fitted), truth.map(fitted)));
        let (own, truth) = pairs.unzip();
        Ok([own, truth])
    }

    /// The difference of the novel view from the photograph, at the smaller of both sizes, so that detail that the
    /// photograph lacks is no error. The novel view has the exposure of the photograph, as in the second score of the summary.
    fn error(&self, taken: &DisplayImage, novel: &DisplayImage, alpha: &[f32]) -> DisplayImage {
        let (width, height) = (taken.width.min(novel.width), taken.height.min(novel.height));
        let alpha =
            Plane { width: novel.width, height: novel.height, values: alpha.iter().map(|a| [*a]).collect() };
        let alpha = alpha.resized(width, height).values.into_flattened();
        let truth = shown_part(self.renderer.model(), taken.resized(width, height), &alpha);
        error_map(&matched(&novel.resized(width, height), &alpha, &truth), &truth)
    }
}

/// Albedo, normals, roughness and ambient occlusion, each with its ground truth. Without materials only the normals
/// exist, and without a visibility field no ambient occlusion.
fn layer_cells(
    model: &Model,
    layers: &ViewLayers,
    view: &CaptureView,
) -> [(Option<DisplayImage>, Option<DisplayImage>); 4] {
    let (width, height) = (layers.shaded.width, layers.shaded.height);
    let picture = |values: Vec<[f32; 3]>| on_white(&Plane { width, height, values }, &layers.alpha);
    let one = |values: &[f32]| on_white(&grey(width, height, values.iter().copied()), &layers.alpha);
    let [albedo, normal, roughness, open] = truth_layers(view);
    let has_materials = model.has_materials();
    let has_visibility = has_materials && model.shading.visibility != VisibilityForm::Off;
    let pair = |exists: bool, own: &dyn Fn() -> DisplayImage, truth| {
        if exists { (Some(own()), truth) } else { (None, None) }
    };
    [
        pair(has_materials, &|| picture(layers.albedo.iter().map(shown_colour).collect()), albedo),
        pair(true, &|| picture(layers.normal.iter().map(shown_normal).collect()), normal),
        pair(has_materials, &|| one(&layers.roughness), roughness),
        pair(has_visibility, &|| one(&layers.visibility), open),
    ]
}

/// A view's ground-truth albedo (sRGB curve), normal (`n / 2 + 1 / 2`), roughness and ambient occlusion, on white;
/// `None` for layers that the view lacks.
fn truth_layers(view: &CaptureView) -> [Option<DisplayImage>; 4] {
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

/// A one-channel layer as a grey image.
fn grey(width: u32, height: u32, values: impl IntoIterator<Item = f32>) -> DisplayImage {
    Plane { width, height, values: values.into_iter().map(|v| [v; 3]).collect() }
}

/// The difference of two images of the same size: from black for equal pixels through red and yellow to white at a
/// mean channel difference of [`ERROR_WHITE`] or more.
fn error_map(a: &DisplayImage, b: &DisplayImage) -> DisplayImage {
    let heat = |(p, q): (&[f32; 3], &[f32; 3])| {
        let difference: f32 = p.iter().zip(q).map(|(x, y)| (x - y).abs()).sum::<f32>() / 3.0;
        let t = (difference / ERROR_WHITE).min(1.0) * 3.0;
        [t.min(1.0), (t - 1.0).clamp(0.0, 1.0), (t - 2.0).clamp(0.0, 1.0)]
    };
    Plane { width: a.width, height: a.height, values: a.values.iter().zip(&b.values).map(heat).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eval::cell::CELL;
    use relume_capture::{Capture, SyntheticOptions, synthetic};
    use relume_scene::{Field, Gaussians, ImageRgba, PackedImage};
    use relume_spec::rendering::Tier;

    /// A model of a few grey Gaussians at the origin.
    fn model() -> Model {
        let mut gaussians = Gaussians::zeroed(3, 1, 1, 0);
        gaussians.field_mut(Field::LogScale).fill(-1.5);
        gaussians.field_mut(Field::OpacityLogit).fill(3.0);
        gaussians.field_mut(Field::Visibility).fill(1.0);
        (0..3).for_each(|i| gaussians.row_mut(Field::Quaternion, i)[0] = 1.0);
        (0..3).for_each(|i| gaussians.row_mut(Field::Mean, i)[0] = 0.3 * i as f32);
        Model::new(gaussians, vec![[0.5; 3]], vec![[0.3; 3]; 32], (8, 4))
    }

    /// A capture with ground truth in its two held-out views.
    fn capture() -> Capture {
        let options =
            SyntheticOptions { size: 16, train_views: 3, test_views: 2, paths: 4, ..Default::default() };
        synthetic(&options).unwrap()
    }

    fn without_truth(mut capture: Capture) -> Capture {
        capture.test.iter_mut().for_each(|view| view.truth = Default::default());
        capture
    }

    fn drawn(model: Model, capture: &Capture) -> Sheet {
        let rows = SheetRows::choose(capture, None);
        contact_sheet(Arc::new(model), &rows, Tier::Preview, &Device::Cpu).unwrap()
    }

    fn titles(sheet: &Sheet) -> Vec<String> {
        sheet.columns().iter().map(|c| format!("{} {}", c.title, c.detail).trim().to_owned()).collect()
    }

    #[test]
    fn sheet_without_ground_truth_has_no_truth_rows() {
        let with = drawn(model(), &capture());
        let truth = |sheet: &Sheet| sheet.row_names().filter(|name| name.ends_with("ground truth")).count();
        assert_eq!((truth(&with), with.row_names().count()), (2, 4), "the control");
        let without = drawn(model(), &without_truth(capture()));
        assert_eq!((truth(&without), without.row_names().count()), (0, 2));
        let columns = |lights: [&str; 2]| {
            let novel =
                ["photograph", "novel view light of the photographs", "error red 8, yellow 17, white 25 %"];
            let layers = ["albedo", "normals", "roughness", "ambient occlusion"].map(str::to_owned);
            let lights = lights.map(|light| format!("relit {light}"));
            [&novel.map(str::to_owned)[..], &lights, &layers].concat()
        };
        assert_eq!(titles(&with), columns(["dawn", "overcast"]));
        assert_eq!(titles(&without), columns(["sunset", "studio"]));
    }

    #[test]
    fn sheet_of_a_model_shows_only_the_layers_it_has() {
        let capture = without_truth(capture());
        let mut open = model();
        open.shading.visibility = VisibilityForm::Off;
        assert!(!titles(&drawn(open, &capture)).contains(&"ambient occlusion".to_owned()));
        let colour_only = Model { card: serde_json::json!({"config": {"warm_up": 1.0}}), ..model() };
        let columns =
            ["photograph", "novel view radiance branch", "error red 8, yellow 17, white 25 %", "normals"];
        assert_eq!(titles(&drawn(colour_only, &capture)), columns);
    }

    #[test]
    fn relit_columns_use_lights_of_the_truth_before_built_in_ones() {
        let names = |capture: &Capture| -> Vec<String> {
            chosen_lights(&SheetRows::choose(capture, None)).into_iter().map(|(name, _)| name).collect()
        };
        let mut capture = capture();
        assert_eq!(names(&capture), ["dawn", "overcast"]);
        capture.lights.retain(|name, _| name == "sunset");
        assert_eq!(names(&capture), ["sunset", "studio"], "each light once");
        capture.lights.clear();
        assert_eq!(names(&capture), BUILTIN_LIGHTS);
    }

    #[test]
    fn pictures_have_cell_size_in_portrait_and_landscape() {
        for ((width, height), cell) in [((12, 16), (240, 320)), ((16, 12), (320, 240))] {
            let mut capture = without_truth(capture());
            for view in &mut capture.test {
                view.camera = view.camera.resized(width, height);
                view.image = view.image.resized(width, height);
            }
            let sheet = drawn(model(), &capture);
            let png = image::load_from_memory(&sheet.encode(Default::default()).unwrap()).unwrap();
            // Nine columns with gaps of 8 pixels; labels are wider than some portrait cells.
            let labels = if width < height { 9 * (CELL - cell.0) } else { 0 };
            assert!((9 * cell.0 + 80..=9 * cell.0 + 80 + labels).contains(&png.width()), "{}", png.width());
            assert!((2 * cell.1..2 * cell.1 + 200).contains(&png.height()), "{}", png.height());
        }
    }

    #[test]
    fn error_ignores_exposure_and_detail_finer_than_the_photograph() {
        let renderer = Renderer::new(Arc::new(model()));
        let painter = RowPainter { renderer: &renderer, lights: Vec::new(), quality: Tier::Preview.into() };
        let grey = |w: u32, shade: &dyn Fn(u32) -> f32| Plane {
            width: w,
            height: 1,
            values: (0..w).map(|i| [shade(i); 3]).collect(),
        };
        let dark = grey(2, &|_| 0.3);
        let striped = grey(8, &|i| if i % 2 == 0 { 0.5 } else { 0.7 });
        let error = painter.error(&dark, &striped, &[1.0; 8]);
        assert_eq!(error.width, 2);
        assert!(error.values.iter().flatten().all(|v| *v < 0.01), "{error:?}");
        let wrong = grey(8, &|i| if i < 4 { 0.2 } else { 0.9 });
        let error = painter.error(&dark, &wrong, &[1.0; 8]);
        assert!(error.values.iter().flatten().any(|v| *v > 0.5), "the control: {error:?}");
    }

    #[test]
    fn error_map_is_black_for_equal_and_white_for_opposite_images() {
        let flat = |v: f32| Plane { width: 2, height: 1, values: vec![[v; 3]; 2] };
        assert_eq!(error_map(&flat(0.0), &flat(0.0)).values, vec![[0.0; 3]; 2]);
        assert_eq!(error_map(&flat(0.0), &flat(1.0)).values, vec![[1.0; 3]; 2]);
    }

    #[test]
    fn views_with_empty_masks_are_not_on_the_sheet() {
        let mut capture = capture();
        for view in &mut capture.test {
            let pixels = vec![[0.0; 4]; 256];
            let empty = ImageRgba { width: 16, height: 16, pixels };
            view.image = PackedImage::new(&empty, relume_scene::BitDepth::Eight);
        }
        let rows = SheetRows::choose(&capture, None);
        let refused = contact_sheet(Arc::new(model()), &rows, Tier::Preview, &Device::Cpu);
        assert!(matches!(refused, Err(EvalError::NoTestViews)), "{refused:?}");
    }
}
