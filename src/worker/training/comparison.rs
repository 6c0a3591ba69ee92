//! Compares a finished model with held-out views.

use std::sync::Arc;

use relume_api::quality::{Figures, Similarity};
use relume_capture::{Capture, CaptureView};
use relume_engine::Device;
use relume_scene::Model;
use relume_spec::rendering::Tier;
use relume_train::eval::{EvalError, NovelViews};

/// Maximum number of views to compare.
pub(super) const MAX_VIEWS: usize = 8;
/// The warning for a capture without held-out views.
pub(super) const NO_VIEWS: &str = "the capture has no held-out views: nothing was compared";
const EMPTY_VIEWS: &str = "no held-out view shows the object: nothing was compared";
const NO_MATERIALS: &str = "the model was trained without materials: only the radiance branch was compared";

/// A comparison with its views. Only the selected held-out views stay in memory.
pub(super) struct Comparison {
    pub waiting: std::vec::IntoIter<CaptureView>,
    /// Number of views to compare.
    pub count: usize,
    pub compared: usize,
    /// Number of held-out views of the capture.
    held_out: usize,
    /// The results, after the first view.
    views: Option<NovelViews>,
}

impl Comparison {
    /// Selects evenly spaced views of `capture`.
    pub fn new(capture: Capture, with_turns: bool) -> Self {
        let views = capture.test;
        let (all, count) = (views.len(), views.len().min(MAX_VIEWS));
        let is_chosen = |i: usize| (0..count).any(|k| k * all / count == i);
        let chosen = views.into_iter().enumerate().filter(|(i, _)| is_chosen(*i));
        let as_trained = |(_, mut view): (usize, CaptureView)| {
            if !with_turns {
                view.light_rotation_deg = 0.0;
            }
            view
        };
        let waiting: Vec<CaptureView> = chosen.map(as_trained).collect();
        Self { waiting: waiting.into_iter(), count, compared: 0, held_out: all, views: None }
    }

    /// Compares one view.
    ///
    /// # Errors
    /// If the device fails or the view cannot be rendered.
    pub fn compare(
        &mut self,
        view: &CaptureView,
        model: &Arc<Model>,
        device: &Device,
    ) -> Result<(), EvalError> {
        let views = match &mut self.views {
            Some(views) => views,
            none => none.insert(NovelViews::new(model.clone(), Tier::Standard.into(), device)?),
        };
        views.compare(view)?;
        self.compared += 1;
        Ok(())
    }

    /// The means over all compared views.
    pub fn figures(&self) -> Figures {
        let scores = self.views.as_ref().map(NovelViews::scores);
        let note = match &scores {
            None => Some(NO_VIEWS),
            Some(scores) if scores.views == 0 => Some(EMPTY_VIEWS),
            Some(scores) if scores.shaded.psnr.is_none() => Some(NO_MATERIALS),
            Some(_) => None,
        };
        let scores = scores.unwrap_or_default();
        let psnr = |psnr| Similarity { psnr, ssim: None };
        Figures {
            views: scores.views,
            held_out_views: self.held_out,
            foreground_pixels: scores.foreground_pixels,
            novel_view: Similarity { psnr: scores.shaded.psnr, ssim: scores.shaded.ssim },
            novel_view_radiance: psnr(scores.radiance.psnr),
            novel_view_matched: psnr(scores.matched.psnr),
            note: note.map(str::to_owned),
            warnings: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_capture::{SyntheticOptions, synthetic};

    fn capture(test_views: usize) -> Capture {
        let options =
            SyntheticOptions { size: 16, train_views: 3, test_views, paths: 4, ..Default::default() };
        synthetic(&options).unwrap()
    }

    #[test]
    fn at_most_eight_evenly_spaced_held_out_views_are_evaluated() {
        let mut capture = capture(20);
        capture.test.iter_mut().for_each(|view| view.light_rotation_deg = 30.0);
        let names: Vec<String> = capture.test.iter().map(|view| view.name.clone()).collect();
        let taken: Vec<CaptureView> = Comparison::new(capture.clone(), true).waiting.collect();
        let expected = [0, 2, 5, 7, 10, 12, 15, 17].map(|i: usize| names[i].clone());
        assert_eq!(taken.iter().map(|view| view.name.clone()).collect::<Vec<_>>(), expected);
        assert!(taken.iter().all(|view| view.light_rotation_deg == 30.0));
        assert_eq!(
            Comparison::new(capture.clone(), true).figures().held_out_views,
            20,
            "all held-out views are counted"
        );
        let still = Comparison::new(capture, false).waiting.next().unwrap();
        assert_eq!(still.light_rotation_deg, 0.0, "the rotation of the light is ignored");
    }

    #[test]
    fn without_held_out_views_metrics_are_empty_with_a_note() {
        let comparison = Comparison::new(capture(0), true);
        assert_eq!(comparison.waiting.len(), 0);
        let figures = comparison.figures();
        assert_eq!(figures, Figures { note: Some(NO_VIEWS.to_owned()), ..Figures::default() });
    }
}
