//! Files that commands read, with errors that name the file.

use std::path::Path;

use crate::formats::model_file;
use crate::scene::Model;

/// The bytes of a file.
pub(super) fn read(path: &Path) -> Result<Vec<u8>, String> {
    std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))
}

/// The model in a model file.
pub(super) fn read_model(path: &Path) -> Result<Model, String> {
    model_file::decode(&read(path)?).map_err(|error| format!("{}: {error}", path.display()))
}
