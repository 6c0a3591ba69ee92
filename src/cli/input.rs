//! Reading of input files, with errors that name the file.

use std::path::Path;

use serde::de::DeserializeOwned;
use serde_json::Value;

use relume_capture::formats::model_file;
use relume_scene::Model;

/// Reads the bytes of a file.
pub(super) fn read(path: &Path) -> Result<Vec<u8>, String> {
    std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))
}

/// Reads the model in a model file.
pub(super) fn read_model(path: &Path) -> Result<Model, String> {
    model_file::decode(&read(path)?).map_err(|error| format!("{}: {error}", path.display()))
}

/// Deserialises JSON. An error names the field.
pub(super) fn from_json<T: DeserializeOwned>(json: Value) -> Result<T, String> {
    serde_path_to_error::deserialize(json).map_err(|e| format!("{}: {}", e.path(), e.inner()))
}
