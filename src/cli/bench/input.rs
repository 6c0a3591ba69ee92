//! Captures and models that the bench commands read.

use std::path::Path;
use std::sync::Arc;

use crate::cli::input;
use relume_capture::{Capture, CaptureError, ImportOptions, import};
use relume_scene::Model;

/// Reads a capture with its ground truth. The longest image side is at most `resolution` pixels.
pub(super) fn read_capture(path: &Path, resolution: u32) -> Result<Capture, CaptureError> {
    import(path, &ImportOptions { max_side: Some(resolution), ..ImportOptions::default() })
}

/// The name of the file or folder, or the whole path if it has no name.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).display().to_string()
}

/// A trained model to measure.
pub(super) struct BenchModel {
    /// The file name without its extension.
    pub(super) name: String,
    pub(super) model: Arc<Model>,
}

impl BenchModel {
    pub(super) fn read(path: &Path) -> Result<Self, String> {
        let name = path.file_stem().unwrap_or(path.as_os_str()).display().to_string();
        Ok(Self { name, model: Arc::new(input::read_model(path)?) })
    }

    /// A text setting of the training; `-` if the card does not have it.
    pub(super) fn setting(&self, key: &str) -> String {
        let value = self.model.card.get("config").and_then(|c| c.get(key));
        value.and_then(|v| v.as_str()).unwrap_or("-").to_owned()
    }

    /// Seconds of the training, if the card has them.
    pub(super) fn training_seconds(&self) -> Option<f64> {
        self.model.card.get("training_seconds").and_then(serde_json::Value::as_f64)
    }
}
