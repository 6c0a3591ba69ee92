//! Models with fewer Gaussians, for exports with a limited size.

use std::sync::Arc;

use rayon::prelude::*;

use crate::dataset::WHITE;
use crate::eval::{mean_squared_error, psnr_of};
use crate::render::{RenderError, Renderer, Turntable};
use relume_scene::{Camera, Field, Model};

/// Elevations of the views in which contributions are summed, degrees.
const ELEVATIONS_DEG: [f64; 3] = [5.0, 35.0, 65.0];
/// Views of each elevation.
const VIEWS: u32 = 16;
/// Width and height of these views, pixels.
const SIDE: u32 = 256;
/// Views in which the result is compared with the model: every so many.
const COMPARED: usize = 6;

/// Powers of the mean widening that closes the gaps of removed Gaussians. The one whose colours are nearest to those of the whole model is used.
const WIDENINGS: [f64; 4] = [0.0, 1.0, 2.0, 3.0];

/// A model with the Gaussians that contribute most.
#[derive(Debug, Clone)]
pub struct PrunedModel {
    /// The model.
    pub model: Model,
    /// PSNR of its colours in the photographs' light against those of the whole model, dB, over views around it at 256 px.
    pub psnr_db: f64,
}

/// The Gaussians of a model in the order of their contribution.
pub struct Contributions {
    renderer: Renderer,
    /// Views in which a result is compared with the model, and the model's colours in them.
    compared: Vec<(Camera, Vec<[f32; 3]>)>,
    /// Indices of the Gaussians, the one with the largest contribution first.
    order: Vec<usize>,
    /// Summed blending weights of the Gaussians in this order up to each of them.
    sums: Vec<f64>,
}

impl Contributions {
    /// Sums the blending weights of each Gaussian over views around a checked model. Stops early once `is_wanted` returns false.
    ///
    /// # Errors
    /// If the model has no views around it, or the result is not wanted.
    pub fn of(model: Arc<Model>, is_wanted: &dyn Fn() -> bool) -> Result<Self, RenderError> {
        let views = views(&model)?;
        let renderer = Renderer::new(model);
        let mut sums = vec![0.0f64; renderer.model().gaussians.len()];
        for view in &views {
            check(is_wanted)?;
            let weights = renderer.host().blending_weights(renderer.view(view)?);
            sums.par_iter_mut().zip(weights).for_each(|(sum, weight)| *sum += f64::from(weight));
        }
        let mut compared = Vec::new();
        for view in views.into_iter().step_by(COMPARED) {
            let colours = renderer.host().radiance(renderer.view(&view)?, WHITE);
            compared.push((view, colours));
        }
        let mut order: Vec<usize> = (0..sums.len()).collect();
        order.sort_by(|a, b| sums[*b].total_cmp(&sums[*a]).then(a.cmp(b)));
        let up_to = |sum: &mut f64, i: &usize| {
            *sum += sums[*i];
            Some(*sum)
        };
        let sums = order.iter().scan(0.0, up_to).collect();
        Ok(Self { renderer, compared, order, sums })
    }

    /// The `most` Gaussians that contribute most, in their order in the model.
    pub fn kept(&self, most: usize) -> Model {
        let mut kept = self.order[..most.min(self.order.len())].to_vec();
        kept.sort_unstable();
        let whole = self.renderer.model();
        Model { gaussians: whole.gaussians.gathered(&kept), ..whole.clone() }
    }

    /// `kept`, the result of [`Self::kept`], widened where that brings its colours nearer to those of the whole model.
    ///
    /// # Errors
    /// If a view cannot be rendered, or the result is not wanted.
    pub fn widened(&self, kept: &Model, is_wanted: &dyn Fn() -> bool) -> Result<PrunedModel, RenderError> {
        let share = |sum: Option<&f64>| sum.copied().unwrap_or(1.0).max(f64::MIN_POSITIVE);
        let of_kept = share(self.sums.get(kept.gaussians.len().saturating_sub(1)));
        let missing = 0.5 * (share(self.sums.last()) / of_kept).ln();
        let mut best = (0.0, f64::NEG_INFINITY);
        for power in WIDENINGS {
            check(is_wanted)?;
            let log_factor = (power * missing) as f32;
            let psnr_db = self.psnr_of(widened(kept.clone(), log_factor))?;
            if psnr_db > best.1 {
                best = (log_factor, psnr_db);
            }
        }
        Ok(PrunedModel { model: widened(kept.clone(), best.0), psnr_db: best.1 })
    }

    /// PSNR of the colours of `model` against those of the whole model.
    fn psnr_of(&self, model: Model) -> Result<f64, RenderError> {
        let renderer = Renderer::new(Arc::new(model));
        let mut sum = 0.0;
        for (view, whole) in &self.compared {
            let colours = renderer.host().radiance(renderer.view(view)?, WHITE);
            sum += psnr_of(mean_squared_error(&colours, whole));
        }
        Ok(sum / self.compared.len().max(1) as f64)
    }
}

fn check(is_wanted: &dyn Fn() -> bool) -> Result<(), RenderError> {
    if is_wanted() { Ok(()) } else { Err(RenderError::Abandoned) }
}

/// `model` with larger Gaussians: their standard deviations times `e^log_factor`.
fn widened(mut model: Model, log_factor: f32) -> Model {
    model.gaussians.field_mut(Field::LogScale).iter_mut().for_each(|scale| *scale += log_factor);
    model
}

fn views(model: &Model) -> Result<Vec<Camera>, RenderError> {
    let mut out = Vec::new();
    for elevation in ELEVATIONS_DEG {
        let ring = Turntable {
            frames: VIEWS,
            azimuth_deg: None,
            elevation_deg: Some(elevation),
            camera_turn_deg: 360.0,
            size: (SIDE, SIDE),
        };
        out.extend(ring.views(model)?.into_iter().map(|view| view.camera));
    }
    Ok(out)
}
