//! How well the confidence of a model predicts its errors.

use std::sync::Arc;

use crate::eval::evaluate::{EvalError, check_sizes, evenly_spaced, lights_of, refused};
use crate::eval::layers::{angle_deg, unit};
use crate::eval::views::foreground;
use crate::render::{Frame, Renderer};
use relume_capture::{Capture, CaptureView};
use relume_scene::{Model, srgb};
use relume_spec::rendering::{Output, Tier};

/// Added to an error before the logarithm of a ratio of gains: dark pixels say little about the level.
const DARK: f32 = 1e-3;

/// How well confidence ranks the pixels of the held-out views by an error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConfidenceScore {
    /// Spearman's rank correlation between 1 - confidence and the error, -1 to 1.
    pub rank_correlation: f64,
    /// Area under the sparsification error: the mean error of the pixels that remain while the least confident ones are removed, minus that
    /// while the worst ones are removed, over the mean error; the mean over all removed shares. 0 is perfect.
    pub ause: f64,
    /// The same for pixels that are removed in a random order.
    pub ause_random: f64,
}

/// Scores of the confidence by the error that it should predict; `None` where the capture has no such ground truth.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ConfidenceScores {
    /// Display values under the capture's relit lights, mean over lights and channels, each picture with one gain per channel.
    pub relit: Option<ConfidenceScore>,
    /// Albedo with the sRGB curve, mean over channels, each picture with one gain per channel.
    pub albedo: Option<ConfidenceScore>,
    /// Angle between normals.
    pub normal: Option<ConfidenceScore>,
}

/// Compares the confidence of a model with its errors in at most `views` held-out views of `capture`.
///
/// # Errors
/// Names the view that cannot be compared.
pub fn confidence_scores(
    model: &Arc<Model>,
    capture: &Capture,
    views: Option<usize>,
) -> Result<ConfidenceScores, EvalError> {
    let views = evenly_spaced(&capture.test, views);
    views.iter().try_for_each(|view| check_sizes(view))?;
    let lights = lights_of(&views, capture);
    let renderer = Renderer::new(model.clone());
    let outputs = [Output::Confidence, Output::Albedo, Output::Normal];
    let own = renderer.prepare_light(model.recovered_light())?;
    let mut pixels: Vec<ViewPixels<'_>> = Vec::new();
    for view in &views {
        let frame = renderer
            .render(&view.camera, &own, Tier::Preview, &outputs)
            .map_err(|source| refused(view, source))?;
        pixels.push(ViewPixels::of(view, &frame));
    }
    for name in &lights {
        let light = renderer.prepare_light(&capture.lights[*name])?;
        for pixels in &mut pixels {
            let Some(truth) = pixels.view.truth.relit.get(*name) else { continue };
            let frame = renderer
                .render(&pixels.view.camera, &light, Tier::Standard, &[Output::Rgb])
                .map_err(|source| refused(pixels.view, source))?;
            let truth: Vec<[f32; 3]> =
                truth.pixels.iter().map(|&[r, g, b, _]| [r, g, b].map(srgb::decode)).collect();
            let errors = pixels.colour_errors(&straight(&frame), &truth);
            pixels.add_relit(&errors);
        }
    }
    for pixels in &mut pixels {
        let lights = pixels.lights;
        pixels.relit.iter_mut().for_each(|sum| *sum /= lights);
    }
    let score = |pick: for<'b, 'c> fn(&'b ViewPixels<'c>) -> &'b Vec<f32>| {
        let errors: Vec<f32> = pixels.iter().flat_map(|p| pick(p).iter().copied()).collect();
        let confidence: Vec<f32> = pixels
            .iter()
            .filter(|p| !pick(p).is_empty())
            .flat_map(|p| p.confidence.iter().copied())
            .collect();
        score(&confidence, &errors)
    };
    Ok(ConfidenceScores {
        relit: score(|p| &p.relit),
        albedo: score(|p| &p.albedo),
        normal: score(|p| &p.normal),
    })
}

/// The compared pixels of a view: inside the mask and covered by the model.
struct ViewPixels<'a> {
    view: &'a CaptureView,
    indices: Vec<usize>,
    confidence: Vec<f32>,
    relit: Vec<f32>,
    /// Number of lights in the sums of `relit`.
    lights: f32,
    albedo: Vec<f32>,
    normal: Vec<f32>,
}

impl<'a> ViewPixels<'a> {
    fn of(view: &'a CaptureView, frame: &Frame) -> Self {
        let plane = |output| frame.planes.get(&output).map_or(&[][..], Vec::as_slice);
        let (alpha, mask) = (plane(Output::Alpha), foreground(&view.image));
        let indices: Vec<usize> = (0..mask.len()).filter(|i| mask[*i] && alpha[*i] > 0.9).collect();
        let confidence = indices.iter().map(|i| plane(Output::Confidence)[*i]).collect();
        let mut out = Self {
            view,
            indices,
            confidence,
            relit: Vec::new(),
            lights: 0.0,
            albedo: Vec::new(),
            normal: Vec::new(),
        };
        if let Some(truth) = &view.truth.albedo {
            out.albedo = out.colour_errors(plane(Output::Albedo).as_chunks::<3>().0, &truth.values);
        }
        if let Some(truth) = &view.truth.normal {
            let found = plane(Output::Normal).as_chunks::<3>().0;
            let angle = |i: &usize| {
                let [a, b] = [found[*i], truth.values[*i]].map(unit);
                angle_deg(a, b) as f32
            };
            out.normal = out.indices.iter().map(angle).collect();
        }
        out
    }

    /// Mean absolute difference of display values at the compared pixels, after one gain per channel: the median ratio.
    fn colour_errors(&self, found: &[[f32; 3]], truth: &[[f32; 3]]) -> Vec<f32> {
        let gain = |c: usize| {
            let ratio = |i: &usize| (truth[*i][c] + DARK) / (found[*i][c] + DARK);
            let mut ratios: Vec<f32> = self.indices.iter().map(ratio).collect();
            let middle = ratios.len() / 2;
            if ratios.is_empty() { 1.0 } else { *ratios.select_nth_unstable_by(middle, f32::total_cmp).1 }
        };
        let gains: [f32; 3] = std::array::from_fn(gain);
        let error = |i: &usize| {
            let of = |c: usize| (srgb::encode(gains[c] * found[*i][c]) - srgb::encode(truth[*i][c])).abs();
            (0..3).map(of).sum::<f32>() / 3.0
        };
        self.indices.iter().map(error).collect()
    }

    fn add_relit(&mut self, errors: &[f32]) {
        self.relit.resize(errors.len(), 0.0);
        self.relit.iter_mut().zip(errors).for_each(|(sum, error)| *sum += error);
        self.lights += 1.0;
    }
}

/// Colours of a frame, not premultiplied.
fn straight(frame: &Frame) -> Vec<[f32; 3]> {
    let plane = |output| frame.planes.get(&output).map_or(&[][..], Vec::as_slice);
    let pixels = plane(Output::Rgb).as_chunks::<3>().0.iter().zip(plane(Output::Alpha));
    pixels.map(|(colour, alpha)| colour.map(|v| v / alpha.max(1e-6))).collect()
}

/// `None` without pixels, or if all have the same confidence or error.
fn score(confidence: &[f32], errors: &[f32]) -> Option<ConfidenceScore> {
    let count = errors.len();
    let mean = errors.iter().map(|e| f64::from(*e)).sum::<f64>() / count.max(1) as f64;
    let [by_confidence, by_error] = [confidence, errors].map(ranks);
    let rank_correlation = -correlation(&by_confidence, &by_error)?;
    let area = |key: &[f32], is_descending: bool| {
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|a, b| key[*a].total_cmp(&key[*b]).then(a.cmp(b)));
        if is_descending {
            order.reverse();
        }
        let (mut sum, mut total) = (0.0, 0.0);
        for (kept, i) in order.iter().enumerate() {
            sum += f64::from(errors[*i]);
            total += sum / (kept + 1) as f64;
        }
        total / count as f64
    };
    let best = area(errors, false);
    Some(ConfidenceScore {
        rank_correlation,
        ause: (area(confidence, true) - best) / mean,
        ause_random: (mean - best) / mean,
    })
}

/// Ranks of values; equal values have their mean rank.
fn ranks(values: &[f32]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut out = vec![0.0; values.len()];
    let mut first = 0;
    for run in order.chunk_by(|a, b| values[*a] == values[*b]) {
        let mean = first as f64 + 0.5 * (run.len() - 1) as f64;
        run.iter().for_each(|i| out[*i] = mean);
        first += run.len();
    }
    out
}

/// Pearson's correlation; `None` if one of the lists is empty or constant.
fn correlation(a: &[f64], b: &[f64]) -> Option<f64> {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let product = |x: &[f64], mean_x: f64, y: &[f64], mean_y: f64| -> f64 {
        x.iter().zip(y).map(|(x, y)| (x - mean_x) * (y - mean_y)).sum()
    };
    let spread = (product(a, mean_a, a, mean_a) * product(b, mean_b, b, mean_b)).sqrt();
    (spread > 0.0).then(|| product(a, mean_a, b, mean_b) / spread)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn perfect_confidence_has_no_sparsification_error() {
        let errors: Vec<f32> = (0..100).map(|i| ((i * 37) % 100) as f32 / 100.0).collect();
        let perfect: Vec<f32> = errors.iter().map(|e| 1.0 - e).collect();
        let found = score(&perfect, &errors).unwrap();
        assert!((found.rank_correlation - 1.0).abs() < 1e-9 && found.ause.abs() < 1e-9, "{found:?}");
        assert!((found.ause_random - 0.5).abs() < 0.02, "{found:?}");
        let inverse = score(&errors, &errors).unwrap();
        assert!((inverse.rank_correlation + 1.0).abs() < 1e-9 && inverse.ause > 0.9, "{inverse:?}");
        assert_eq!(score(&[0.5; 100], &errors), None);
        assert_eq!(score(&[], &[]), None);
    }

    #[test]
    fn equal_values_have_their_mean_rank() {
        assert_eq!(ranks(&[3.0, 1.0, 3.0, 2.0]), [2.5, 0.0, 2.5, 1.0]);
    }
}
