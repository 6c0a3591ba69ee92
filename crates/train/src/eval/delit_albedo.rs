//! The albedo of photographs without their light against the ground truth.

use crate::delight::Delighter;
use crate::eval::evaluate::{EvalError, check_sizes, evenly_spaced, refused};
use crate::eval::image::{mean_squared_error, psnr_of};
use crate::eval::layers::RatioMedian;
use crate::eval::views::foreground;
use relume_capture::Capture;
use relume_engine::Device;
use relume_scene::{Model, srgb};

/// PSNR of albedo with the sRGB curve inside the masks, dB, after one gain per channel: the median ratio over all compared pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DelitAlbedoScores {
    /// Of the model's albedo.
    pub model: f64,
    /// Of the albedo with the detail of the photographs.
    pub delit: f64,
}

/// Compares the albedo layers of at most `views` held-out photographs of `capture`. `None` without ground-truth albedo.
///
/// # Errors
/// Names the view that cannot be compared.
pub fn delit_albedo_scores(
    model: &std::sync::Arc<Model>,
    capture: &Capture,
    views: Option<usize>,
) -> Result<Option<DelitAlbedoScores>, EvalError> {
    let mut delighter = Delighter::new(model.clone(), &Device::Cpu)?;
    let (mut truths, mut of_model, mut delit) = (Vec::new(), Vec::new(), Vec::new());
    for view in evenly_spaced(&capture.test, views) {
        check_sizes(view)?;
        let Some(truth) = &view.truth.albedo else { continue };
        let layers = delighter.delight(view).map_err(|source| refused(view, source))?;
        let mask = foreground(&view.image);
        let compared: Vec<usize> = (0..mask.len()).filter(|i| mask[*i] && layers.alpha[*i] > 0.9).collect();
        let pick = |values: &[[f32; 3]]| -> Vec<[f32; 3]> { compared.iter().map(|i| values[*i]).collect() };
        truths.extend(pick(&truth.values));
        of_model.extend(pick(&layers.model_albedo));
        delit.extend(pick(&layers.albedo));
    }
    let score = |found: &[[f32; 3]]| {
        let mut ratios = RatioMedian::default();
        ratios.add(found, &truths, &vec![true; truths.len()]);
        let gains = ratios.median()?;
        let shown = |colours: &[[f32; 3]], gains: [f32; 3]| -> Vec<[f32; 3]> {
            colours.iter().map(|v| std::array::from_fn(|c| srgb::encode(v[c] * gains[c]))).collect()
        };
        Some(psnr_of(mean_squared_error(&shown(found, gains), &shown(&truths, [1.0; 3]))))
    };
    Ok(score(&of_model).zip(score(&delit)).map(|(model, delit)| DelitAlbedoScores { model, delit }))
}
