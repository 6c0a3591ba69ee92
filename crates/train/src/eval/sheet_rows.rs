//! The views in the rows of a contact sheet.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::eval::cell::CELL;
use crate::eval::evaluate::{evenly_spaced, shows_object};
use crate::eval::report::{Report, ViewScore};
use relume_capture::{
    Capture, CaptureError, CaptureView, ColourMatrix, ImportLimits, ImportOptions, UndecodedCapture, Up,
};
use relume_scene::EnvMap;
use relume_spec::training::TurntableCapture;

/// Number of evenly spaced views on a sheet. The weakest view is one more.
const ROWS: usize = 3;

/// The views of a sheet, and the lights of their ground truth.
#[derive(Debug, Clone, PartialEq)]
pub struct SheetRows {
    /// A label and a view for each row.
    pub(super) rows: Vec<(String, CaptureView)>,
    pub(super) lights: BTreeMap<String, EnvMap>,
}

impl SheetRows {
    /// Three evenly spaced held-out views of `capture`, and the weakest view of `report` if it is another one. Without
    /// held-out views these are training views. A view whose mask is empty is left out.
    pub fn choose(capture: &Capture, report: Option<&Report>) -> Self {
        let (views, kind) = match capture.test.is_empty() {
            true => (&capture.train, "trained on"),
            false => (&capture.test, "held out"),
        };
        let weakest = report.and_then(|report| report.weakest_view.as_ref());
        let is_weakest = |view: &CaptureView| weakest.is_some_and(|worst| worst.view == view.name);
        let shown: Vec<&CaptureView> = views.iter().filter(|view| shows_object(view)).collect();
        let mut chosen = evenly_spaced(&shown, Some(ROWS)).into_iter().copied().collect::<Vec<_>>();
        if !chosen.iter().any(|view| is_weakest(view)) {
            chosen.extend(shown.iter().find(|view| is_weakest(view)));
        }
        let label = |view: &CaptureView| match weakest.filter(|worst| worst.view == view.name) {
            Some(ViewScore { psnr, .. }) => format!("{}, {kind}, the weakest: {psnr:.1} dB", view.name),
            None => format!("{}, {kind}", view.name),
        };
        let rows = chosen.into_iter().map(|view| (label(view), view.clone())).collect();
        Self { rows, lights: capture.lights.clone() }
    }

    /// Number of rows.
    pub fn count(&self) -> usize {
        self.rows.len()
    }

    /// Keeps the first `rows` rows.
    pub fn truncate(&mut self, rows: usize) {
        self.rows.truncate(rows);
    }

    /// Reads the photographs of these views again from the capture at `path`, at the size of a cell, with the ground
    /// truth that the capture has. A training and `--resolution` reduce photographs to less. Light rotations are kept; `colour_matrix` is that
    /// of the model ([`crate::colour_matrix_of_card`]).
    ///
    /// # Errors
    /// The error of the import. The views are then unchanged.
    pub fn read_again(
        &mut self,
        path: &Path,
        up: Up,
        colour_matrix: Option<ColourMatrix>,
        limits: &ImportLimits,
    ) -> Result<(), CaptureError> {
        let (turntable, max_side, limits) = (TurntableCapture::No, Some(CELL), *limits);
        let options = ImportOptions { max_side, limits, load_truth: true, up, turntable, colour_matrix };
        let mut undecoded = UndecodedCapture::open(path, &options)?;
        let names: BTreeSet<&str> = self.rows.iter().map(|(_, view)| view.name.as_str()).collect();
        undecoded.retain(&names)?;
        let Capture { train, test, lights, .. } = undecoded.decode()?;
        for read in train.into_iter().chain(test) {
            if let Some((_, view)) = self.rows.iter_mut().find(|(_, view)| view.name == read.name) {
                *view = CaptureView { light_rotation_deg: view.light_rotation_deg, ..read };
            }
        }
        self.lights = lights;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_capture::{SyntheticOptions, synthetic, write_archive};

    fn capture(test_views: usize, size: u32) -> Capture {
        let options = SyntheticOptions { size, train_views: 4, test_views, paths: 4, ..Default::default() };
        synthetic(&options).unwrap()
    }

    fn names(rows: &SheetRows) -> Vec<&str> {
        rows.rows.iter().map(|(label, _)| label.as_str()).collect()
    }

    #[test]
    fn rows_are_held_out_views_and_the_weakest_one() {
        let held_out = capture(6, 8);
        let first =
            ["test_000/rgba.png, held out", "test_002/rgba.png, held out", "test_004/rgba.png, held out"];
        assert_eq!(names(&SheetRows::choose(&held_out, None)), first);
        let weakest = |view: &str| Report {
            weakest_view: Some(ViewScore { view: view.to_owned(), psnr: 18.25 }),
            ..Report::default()
        };
        let with_another = SheetRows::choose(&held_out, Some(&weakest("test_005/rgba.png")));
        assert_eq!(names(&with_another)[..3], first);
        assert_eq!(names(&with_another)[3], "test_005/rgba.png, held out, the weakest: 18.2 dB");
        assert_eq!(SheetRows::choose(&held_out, Some(&weakest("test_002/rgba.png"))).rows.len(), 3);
        let trained = SheetRows::choose(&capture(0, 8), None);
        assert_eq!(names(&trained)[0], "train_000/rgba.png, trained on");
    }

    #[test]
    fn photographs_are_read_again_larger_and_with_truth() {
        let stored = capture(2, 24);
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), write_archive(&stored).unwrap()).unwrap();
        let options = ImportOptions { max_side: Some(16), load_truth: false, ..ImportOptions::default() };
        let mut trained = relume_capture::import(file.path(), &options).unwrap();
        trained.test[0].light_rotation_deg = 30.0;
        let mut rows = SheetRows::choose(&trained, None);
        assert_eq!((rows.rows[0].1.image.width, rows.lights.len()), (16, 0), "the control");
        assert!(rows.rows[0].1.truth.albedo.is_none(), "the control");
        rows.read_again(file.path(), Up::AUTO, None, &ImportLimits::default()).unwrap();
        let view = &rows.rows[0].1;
        assert_eq!((view.image.width, view.camera.width, view.light_rotation_deg), (24, 24, 30.0));
        assert!(view.truth.albedo.is_some() && rows.lights.len() == 3 && rows.rows.len() == 2);
        let before = rows.clone();
        let gone = rows.read_again(Path::new("no/such.zip"), Up::AUTO, None, &ImportLimits::default());
        assert!(gone.is_err() && rows == before, "an error leaves the views as they are");
    }
}
