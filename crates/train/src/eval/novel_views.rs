//! Compares novel views one at a time, for callers that interleave other work.

use std::sync::Arc;

use crate::eval::EvalError;
use crate::eval::evaluate::{check_sizes, refused, shows_object};
use crate::eval::exposure::matched;
use crate::eval::report::ImageScores;
use crate::eval::totals::ImageTotals;
use crate::eval::views::{ViewLayers, foreground, light_of, shown_by};
use crate::render::{Renderer, RotatedLight};
use relume_capture::CaptureView;
use relume_engine::Device;
use relume_scene::Model;
use relume_spec::rendering::Quality;

/// A comparison of a model with photographs, as in [`crate::eval::evaluate()`], without LPIPS.
pub struct NovelViews {
    renderer: Renderer,
    light: RotatedLight,
    quality: Quality,
    has_materials: bool,
    shaded: ImageTotals,
    radiance: ImageTotals,
    matched: ImageTotals,
    compared: usize,
    foreground_pixels: u64,
}

/// Means over the compared views.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct NovelViewScores {
    /// The physically based branch; empty for a model without materials.
    pub shaded: ImageScores,
    /// The radiance branch.
    pub radiance: ImageScores,
    /// As `shaded`, at the exposure and white balance of each photograph.
    pub matched: ImageScores,
    /// Number of compared views.
    pub views: usize,
    /// Number of pixels of the object in the compared photographs: those inside the masks, without masks all.
    pub foreground_pixels: u64,
}

impl NovelViews {
    /// A comparison without views.
    ///
    /// # Errors
    /// [`EvalError::Device`].
    pub fn new(model: Arc<Model>, quality: Quality, device: &Device) -> Result<Self, EvalError> {
        Ok(Self {
            has_materials: model.has_materials(),
            renderer: Renderer::on(model, device)?,
            light: RotatedLight::default(),
            quality,
            shaded: ImageTotals::default(),
            radiance: ImageTotals::default(),
            matched: ImageTotals::default(),
            compared: 0,
            foreground_pixels: 0,
        })
    }

    /// Compares one view. A view whose mask is empty is not compared.
    ///
    /// # Errors
    /// See [`EvalError`].
    pub fn compare(&mut self, view: &CaptureView) -> Result<(), EvalError> {
        check_sizes(view)?;
        if !shows_object(view) {
            return Ok(());
        }
        let light = light_of(&self.renderer, view, &mut self.light)?;
        let layers = ViewLayers::render(&self.renderer, &view.camera, light, self.quality)
            .map_err(|source| refused(view, source))?;
        let truth = shown_by(self.renderer.model(), view, &layers.alpha);
        self.compared += 1;
        self.foreground_pixels +=
            foreground(&view.image).iter().filter(|is_inside| **is_inside).count() as u64;
        self.radiance.add(&layers.radiance, &truth, None);
        if self.has_materials {
            self.shaded.add(&layers.shaded, &truth, None);
            self.matched.add(&matched(&layers.shaded, &layers.alpha, &truth), &truth, None);
        }
        Ok(())
    }

    /// Scores of the views compared so far.
    pub fn scores(&self) -> NovelViewScores {
        let (shaded, radiance) = (self.shaded.scores(), self.radiance.scores());
        NovelViewScores {
            shaded,
            radiance,
            matched: self.matched.scores(),
            views: self.compared,
            foreground_pixels: self.foreground_pixels,
        }
    }
}
