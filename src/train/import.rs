//! Captures as trainings load them.

use std::path::Path;

use crate::capture::{self, Capture, CaptureError, ImportOptions};
use crate::train::TrainConfig;

/// A capture at the resolution it will be trained at, without ground truth, so that memory holds no pixel in vain; with
/// the turns of the light that `config` gives.
///
/// # Errors
/// What the importer refuses, by file and field; a turn of the light of no photograph.
pub fn import_for_training(path: &Path, config: &TrainConfig) -> Result<Capture, CaptureError> {
    let options =
        ImportOptions { max_side: Some(config.resolution), load_truth: false, ..ImportOptions::default() };
    let mut capture = capture::import(path, &options)?;
    capture.turn_lights(&config.light_rotation_per_photo)?;
    Ok(capture)
}
