//! A trained model that is measured, with what its card says of how it was made.

use std::path::Path;
use std::sync::Arc;

use crate::formats::model_file;
use crate::scene::Model;

pub(super) struct Subject {
    /// The file's name without its ending.
    pub(super) name: String,
    pub(super) model: Arc<Model>,
}

impl Subject {
    pub(super) fn read(path: &Path) -> Result<Self, String> {
        let shown = path.display();
        let bytes = std::fs::read(path).map_err(|e| format!("{shown}: {e}"))?;
        let model = model_file::decode(&bytes).map_err(|e| format!("{shown}: {e}"))?;
        let name = path.file_stem().map_or_else(|| shown.to_string(), |n| n.to_string_lossy().into_owned());
        Ok(Self { name, model: Arc::new(model) })
    }

    /// A setting it was trained with, `-` when the card does not say.
    pub(super) fn setting(&self, key: &str) -> String {
        let value = self.model.card.get("config").and_then(|c| c.get(key));
        value.and_then(|v| v.as_str()).unwrap_or("-").to_owned()
    }

    /// How long its training took, if the card says.
    pub(super) fn training_seconds(&self) -> Option<f64> {
        self.model.card.get("training_seconds").and_then(serde_json::Value::as_f64)
    }
}
