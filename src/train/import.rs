//! Captures as trainings load them.

use std::path::Path;

use crate::capture::{self, Capture, CaptureError, ImportOptions};
use crate::train::TrainConfig;

/// A capture at the resolution it will be trained at, without ground truth, so that memory holds no pixel in vain.
///
/// # Errors
/// What the importer refuses, by file and field.
pub fn import_for_training(path: &Path, config: &TrainConfig) -> Result<Capture, CaptureError> {
    let options =
        ImportOptions { max_side: Some(config.resolution), load_truth: false, ..ImportOptions::default() };
    capture::import(path, &options)
}
