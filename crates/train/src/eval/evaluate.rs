//! Evaluates a model against a capture's held-out views and their ground truth.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::calibration::with_scaled_albedo;
use crate::eval::exposure::matched;
use crate::eval::image::{DisplayImage, psnr};
use crate::eval::layers::{albedo_psnr, masked_psnr};
use crate::eval::lpips::Lpips;
use crate::eval::report::{AlbedoScores, ImageScores, RelitScores, Report};
use crate::eval::totals::{ImageTotals, LayerTotals, Mean};
use crate::eval::views::{ViewLayers, foreground, is_cropped, light_of, photograph, relit, shown_by};
use crate::render::{RenderError, Renderer, RotatedLight};
use relume_capture::{Capture, CaptureView};
use relume_engine::{Device, DeviceError};
use relume_scene::{ImageRgba, Model, Plane};
use relume_spec::rendering::{Output, Quality, Tier};

/// Options of [`evaluate`].
pub struct EvalOptions<'a> {
    /// LPIPS with its weights. Without it the LPIPS values are null and the report says so.
    pub lpips: Option<&'a Lpips>,
    /// Number of test views to compare, evenly spaced; `None` for all.
    pub views: Option<usize>,
    /// The tier of the compared images.
    pub quality: Quality,
    /// Least wall-clock time to measure the frame rate of each tier; zero skips the measurement.
    pub frame_rate_time: Duration,
    /// Device that renders.
    pub device: &'a Device,
    /// Called after each rendered view with the number of completed views and the total.
    pub progress: &'a dyn Fn(usize, usize),
}

impl EvalOptions<'_> {
    /// The default tier: its shadows of strong small lights are as sharp as those in photographs.
    pub const TIER: Tier = Tier::High;
}

impl Default for EvalOptions<'_> {
    fn default() -> Self {
        Self {
            lpips: None,
            views: None,
            quality: Self::TIER.into(),
            frame_rate_time: Duration::from_secs(1),
            device: &Device::Cpu,
            progress: &|_, _| {},
        }
    }
}

/// Errors of an evaluation.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EvalError {
    /// The capture has no test views.
    #[error("the capture has no held-out views that show the object")]
    NoTestViews,
    /// An image or layer of a view has another size than its camera.
    #[error("view {view}: {layer} is {found}, but its camera has {expected} pixels")]
    Size {
        /// The view.
        view: String,
        /// The image or layer.
        layer: String,
        /// Its size.
        found: String,
        /// The camera's size.
        expected: String,
    },
    /// A view could not be rendered.
    #[error("view {view}: {source}")]
    Render {
        /// The view.
        view: String,
        /// The renderer's error.
        source: RenderError,
    },
    /// The device failed.
    #[error(transparent)]
    Device(#[from] DeviceError),
}

/// Compares a model with a capture: novel views (both branches), relit views of each light, material and geometry
/// layers. The images have the size of the capture's views and a white background.
///
/// # Errors
/// [`EvalError`] names the view and layer that cannot be compared. A missing *kind* of ground truth is not an error:
/// its values are null and [`Report::notes`] states the reason.
pub fn evaluate(
    model: Arc<Model>,
    capture: &Capture,
    options: &EvalOptions<'_>,
) -> Result<Report, EvalError> {
    let mut views = evenly_spaced(&capture.test, options.views);
    views.retain(|view| shows_object(view));
    if views.is_empty() {
        return Err(EvalError::NoTestViews);
    }
    views.iter().try_for_each(|view| check_sizes(view))?;
    let lights = lights_of(&views, capture);
    let mut run = Evaluation { capture, options, views, lights, done: std::cell::Cell::new(0) };
    run.evaluate(model)
}

/// The state of one evaluation.
struct Evaluation<'a> {
    capture: &'a Capture,
    options: &'a EvalOptions<'a>,
    views: Vec<&'a CaptureView>,
    /// Lights with both relit ground truth and a map.
    lights: Vec<&'a str>,
    done: std::cell::Cell<usize>,
}

impl Evaluation<'_> {
    fn evaluate(&mut self, model: Arc<Model>) -> Result<Report, EvalError> {
        let renderer = Renderer::on(model.clone(), self.options.device)?;
        let mut report = Report {
            protocol: self.protocol(),
            views: self.views.len(),
            gaussians: model.gaussians.len(),
            training_seconds: model.card.get("training_seconds").and_then(serde_json::Value::as_f64),
            ..Report::default()
        };
        self.under_recovered_light(&renderer, &mut report)?;
        let has_materials = model.has_materials();
        if has_materials {
            report.relit = self.relit(&renderer)?;
        } else {
            clear_material_scores(&mut report);
        }
        if let Some(scale) = report.albedo.scale {
            let aligned = Renderer::on(Arc::new(with_scaled_albedo(&model, scale)), self.options.device)?;
            self.aligned_albedo(&aligned, &mut report)?;
            report.relit_aligned = self.relit(&aligned)?;
        }
        self.frame_rates(&renderer, &mut report)?;
        self.explain_absences(&mut report);
        if is_cropped(&model) {
            explain_crop(&mut report);
        }
        if !has_materials {
            explain_no_materials(&mut report);
        }
        Ok(report)
    }

    /// Compares novel views and layers under the recovered light, rotated as in each photograph.
    fn under_recovered_light(&self, renderer: &Renderer, report: &mut Report) -> Result<(), EvalError> {
        let mut own = RotatedLight::default();
        let (mut shaded, mut radiance) = (ImageTotals::default(), ImageTotals::default());
        let (mut shaded_matched, mut radiance_matched) = (ImageTotals::default(), ImageTotals::default());
        let mut totals = LayerTotals::default();
        let (mut inside, mut pixels) = (Mean::default(), (0u64, 0u64));
        let has_materials = renderer.model().has_materials();
        for view in &self.views {
            let light = light_of(renderer, view, &mut own)?;
            let layers = ViewLayers::render(renderer, &view.camera, light, self.options.quality)
                .map_err(|source| refused(view, source))?;
            let truth = shown_by(renderer.model(), view, &layers.alpha);
            shaded.add(&layers.shaded, &truth, self.options.lpips);
            radiance.add(&layers.radiance, &truth, self.options.lpips);
            let at_its_exposure = |picture: &DisplayImage| matched(picture, &layers.alpha, &truth);
            let matched = [&layers.shaded, &layers.radiance].map(at_its_exposure);
            shaded_matched.add(&matched[0], &truth, self.options.lpips);
            radiance_matched.add(&matched[1], &truth, self.options.lpips);
            report.note_view(&view.name, psnr(&matched[usize::from(!has_materials)], &truth));
            totals.add(&layers, view);
            let mask = foreground(&view.image);
            inside.add(masked_psnr(&layers.shaded.values, &truth.values, &mask));
            pixels.0 += mask.iter().filter(|is_inside| **is_inside).count() as u64;
            pixels.1 += mask.len() as u64;
            self.step();
        }
        report.foreground_pixels = pixels.0;
        report.foreground_share = Some(pixels.0 as f64 / pixels.1.max(1) as f64);
        report.novel_view_foreground_psnr = inside.value();
        report.novel_view = shaded.scores();
        report.novel_view_radiance = radiance.scores();
        report.novel_view_matched = shaded_matched.scores();
        report.novel_view_radiance_matched = radiance_matched.scores();
        totals.write(report);
        Ok(())
    }

    /// Compares the albedo of the aligned model with the truth. The model is aligned already, so the comparison scales nothing.
    fn aligned_albedo(&self, aligned: &Renderer, report: &mut Report) -> Result<(), EvalError> {
        let light = aligned.prepare_light(aligned.model().recovered_light())?;
        let (mut whole, mut foreground) = (Mean::default(), Mean::default());
        for view in &self.views {
            let Some(truth) = &view.truth.albedo else { continue };
            let frame = aligned
                .render(&view.camera, &light, self.options.quality, &[Output::Albedo])
                .map_err(|source| refused(view, source))?;
            let plane = |o| frame.planes.get(&o).map_or(&[][..], |p| p.as_slice());
            let (albedo, alpha) = (plane(Output::Albedo).as_chunks::<3>().0, plane(Output::Alpha));
            let [all, inside] = albedo_psnr((albedo, alpha), truth, &view.image);
            whole.add(all);
            foreground.add(inside);
            self.step();
        }
        report.albedo.psnr_aligned = whole.value();
        report.albedo.psnr_aligned_foreground = foreground.value();
        Ok(())
    }

    /// Compares relit images with their ground truth, for each light.
    fn relit(&self, renderer: &Renderer) -> Result<RelitScores, EvalError> {
        let mut scores = RelitScores::default();
        for &name in &self.lights {
            let light = renderer.prepare_light(&self.capture.lights[name])?;
            let mut totals = ImageTotals::default();
            for view in &self.views {
                let Some(truth) = view.truth.relit.get(name) else { continue };
                let picture = relit(renderer, &view.camera, &light, self.options.quality)
                    .map_err(|source| refused(view, source))?;
                totals.add(&picture, &photograph(truth), self.options.lpips);
                self.step();
            }
            scores.lights.insert(name.to_owned(), totals.scores());
        }
        let mean = |pick: fn(&ImageScores) -> Option<f64>| {
            let mut mean = Mean::default();
            scores.lights.values().for_each(|s| mean.add(pick(s)));
            mean.value()
        };
        scores.mean =
            ImageScores { psnr: mean(|s| s.psnr), ssim: mean(|s| s.ssim), lpips: mean(|s| s.lpips) };
        Ok(scores)
    }

    /// Measures relit frames per second of every tier over the test cameras in turn, after one frame to warm up.
    fn frame_rates(&self, renderer: &Renderer, report: &mut Report) -> Result<(), EvalError> {
        if self.options.frame_rate_time.is_zero() {
            return Ok(());
        }
        let recovered = || renderer.model().recovered_light();
        let light = self.lights.first().map_or_else(recovered, |name| (&self.capture.lights[*name]).into());
        let light = renderer.prepare_light(light)?;
        for tier in [Tier::Preview, Tier::Standard, Tier::High] {
            let draw = |view: &CaptureView| {
                let frame = renderer.render(&view.camera, &light, tier, &[Output::Rgb]);
                frame.map(drop).map_err(|source| refused(view, source))
            };
            draw(self.views[0])?;
            let (start, mut frames) = (Instant::now(), 0u32);
            while frames < 3 || start.elapsed() < self.options.frame_rate_time {
                draw(self.views[frames as usize % self.views.len()])?;
                frames += 1;
            }
            let rate = f64::from(frames) / start.elapsed().as_secs_f64().max(1e-9);
            report.render_fps.insert(tier.name().to_owned(), rate);
        }
        Ok(())
    }

    /// Reports one rendered view. The total assumes that albedo can be aligned if any view has its ground truth.
    fn step(&self) {
        let albedo = usize::from(self.views.iter().any(|v| v.truth.albedo.is_some()));
        let passes = 1 + albedo + self.lights.len() * (1 + albedo);
        self.done.set(self.done.get() + 1);
        (self.options.progress)(self.done.get(), passes * self.views.len());
    }

    fn protocol(&self) -> String {
        let sizes: BTreeSet<String> =
            self.views.iter().map(|v| format!("{}x{}", v.camera.width, v.camera.height)).collect();
        let sizes = sizes.into_iter().collect::<Vec<_>>().join(", ");
        let tier = match self.options.quality {
            Quality { tier: tier @ Tier::MonteCarlo, samples, .. } => {
                format!("{} ({samples} samples)", tier.name())
            }
            Quality { tier, .. } => tier.name().to_owned(),
        };
        format!(
            "{} of {} held-out views at {sizes} px, tier {tier}; whole image on white, \
             srgb(clamp(rgb/alpha,0,1))*alpha+1-alpha against the stored sRGB pixels, 32-bit predictions, no \
             ground-truth mask, no scaling of images; every value is computed per image, then averaged (relit.mean over \
             lights); exposure matched: one gain per channel and image, least squares in linear light; \
             PSNR peak 1; SSIM 11x11 Gaussian window, sigma 1.5, valid region, per channel (TensoIR); \
             LPIPS v0.1 AlexNet; relit uses the recovered albedo unchanged, relit_aligned multiplies prototypes and \
             residuals (the renderer clamps albedo to 1) by albedo.scale = per-channel median of truth/prediction \
             (prediction >= 1e-6) over all compared views where ground-truth alpha > 0.5; albedo is compared in linear \
             light, on white over the whole image and separately over the foreground; normal foreground where ground-truth \
             alpha > 0.5, all_pixels as TensoIR with both sides blended with (0,0,1) by alpha; AO, roughness, metalness \
             and depth MAE over the foreground (depth where both have a value)",
            self.views.len(),
            self.capture.test.len(),
        )
    }

    /// Adds a note for each value that is null.
    fn explain_absences(&self, report: &mut Report) {
        let mut notes = std::mem::take(&mut report.notes);
        let mut note = |absent: bool, key: &str, reason: &str| {
            if absent {
                notes.insert(key.to_owned(), reason.to_owned());
            }
        };
        let lpips = match self.options.lpips {
            None => "no LPIPS weights were given",
            Some(_) => "the views are smaller than 31 pixels per side",
        };
        for (group, scores) in [
            ("novel_view", &report.novel_view),
            ("novel_view_radiance", &report.novel_view_radiance),
            ("novel_view_matched", &report.novel_view_matched),
            ("novel_view_radiance_matched", &report.novel_view_radiance_matched),
            ("relit.mean", &report.relit.mean),
            ("relit_aligned.mean", &report.relit_aligned.mean),
        ] {
            let none = scores.psnr.is_none();
            note(none, group, "no light has both a map and relit ground truth");
            note(
                !none && scores.ssim.is_none(),
                &format!("{group}.ssim"),
                "the views are smaller than 11 pixels per side",
            );
            note(!none && scores.lpips.is_none(), &format!("{group}.lpips"), lpips);
        }
        let unaligned = report.albedo.scale.is_none() && report.relit.mean.psnr.is_some();
        note(unaligned, "relit_aligned.mean", "requires ground-truth albedo");
        let absent = "the capture has no such ground-truth layer, or no foreground in it";
        note(report.albedo.psnr_raw.is_none(), "albedo", absent);
        note(report.normal_mae_deg.foreground.is_none(), "normal_mae_deg", absent);
        note(report.ao_mae.is_none(), "ao_mae", absent);
        note(report.roughness_mae.is_none(), "roughness_mae", absent);
        note(report.metallic_mae.is_none(), "metallic_mae", absent);
        note(report.depth_mae.is_none(), "depth_mae", absent);
        note(report.training_seconds.is_none(), "training_seconds", "the model card does not state it");
        note(report.render_fps.is_empty(), "render_fps", "was not requested");
        for name in self.views.iter().flat_map(|v| v.truth.relit.keys()) {
            let unknown = !self.capture.lights.contains_key(name);
            note(unknown, &format!("relit.{name}"), "the capture contains no map of this light");
        }
        report.notes = notes;
    }
}

/// Removes the scores of materials, which the model never trained.
fn clear_material_scores(report: &mut Report) {
    report.novel_view = ImageScores::default();
    report.novel_view_matched = ImageScores::default();
    report.novel_view_foreground_psnr = None;
    report.albedo = AlbedoScores::default();
    (report.ao_mae, report.roughness_mae, report.metallic_mae) = (None, None, None);
}

fn explain_no_materials(report: &mut Report) {
    let figures = [
        "novel_view",
        "novel_view_matched",
        "relit.mean",
        "relit_aligned.mean",
        "albedo",
        "ao_mae",
        "roughness_mae",
        "metallic_mae",
    ];
    let reason = "the model was trained for colour only and has no materials";
    report.notes.extend(figures.map(|figure| (figure.to_owned(), reason.to_owned())));
}

fn explain_crop(report: &mut Report) {
    let reason = "compared only where the cropped model covers the photographs";
    let figures = ["novel_view", "novel_view_radiance", "novel_view_matched", "novel_view_radiance_matched"];
    report.notes.extend(figures.map(|figure| (figure.to_owned(), reason.to_owned())));
}

pub(crate) fn refused(view: &CaptureView, source: RenderError) -> EvalError {
    EvalError::Render { view: view.name.clone(), source }
}

/// `count` of the views, evenly spaced over the list; all of them if there are no more.
pub fn evenly_spaced<T>(views: &[T], count: Option<usize>) -> Vec<&T> {
    let count = count.unwrap_or(views.len()).min(views.len());
    (0..count).map(|i| &views[i * views.len() / count]).collect()
}

/// Whether a photograph has a pixel of the object. Without one a comparison would only show that white equals white.
pub(crate) fn shows_object(view: &CaptureView) -> bool {
    view.image.is_opaque() || foreground(&view.image).contains(&true)
}

/// Names of the lights with relit ground truth in some view and a map in the capture.
pub fn lights_of<'a>(views: &[&'a CaptureView], capture: &Capture) -> Vec<&'a str> {
    let named: BTreeSet<&str> = views.iter().flat_map(|v| v.truth.relit.keys()).map(String::as_str).collect();
    named.into_iter().filter(|name| capture.lights.contains_key(*name)).collect()
}

/// Checks that every image and layer has the size of the camera, so that corresponding pixels are compared.
pub(crate) fn check_sizes(view: &CaptureView) -> Result<(), EvalError> {
    let camera = (view.camera.width, view.camera.height);
    let check = |layer: &str, size: (u32, u32), count: usize| {
        if size == camera && count == camera.0 as usize * camera.1 as usize {
            return Ok(());
        }
        Err(EvalError::Size {
            view: view.name.clone(),
            layer: layer.to_owned(),
            found: format!("{}x{} ({count} values)", size.0, size.1),
            expected: format!("{}x{}", camera.0, camera.1),
        })
    };
    let image = |name: &str, i: &ImageRgba| check(name, (i.width, i.height), i.pixels.len());
    fn extent<const C: usize>(p: &Plane<C>) -> ((u32, u32), usize) {
        ((p.width, p.height), p.values.len())
    }
    check("image", (view.image.width, view.image.height), view.image.len())?;
    view.truth.relit.iter().try_for_each(|(name, i)| image(&format!("relit {name}"), i))?;
    let truth = &view.truth;
    let planes = [
        ("albedo", truth.albedo.as_ref().map(extent)),
        ("normal", truth.normal.as_ref().map(extent)),
        ("metallic_roughness", truth.metallic_roughness.as_ref().map(extent)),
        ("ambient_occlusion", truth.ambient_occlusion.as_ref().map(extent)),
        ("depth", truth.depth.as_ref().map(extent)),
    ];
    let present = planes.into_iter().filter_map(|(name, plane)| plane.map(|(size, n)| (name, size, n)));
    present.into_iter().try_for_each(|(name, size, n)| check(name, size, n))
}
