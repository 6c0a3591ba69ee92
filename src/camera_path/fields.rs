//! Reads fields of JSON. Errors name the field.

use serde::de::DeserializeOwned;
use serde_json::Value;

use relume_api::problem::FieldError;

/// Deserialises a JSON value. An error names the field.
pub(super) fn fields<T: DeserializeOwned>(json: &Value) -> Result<T, FieldError> {
    serde_path_to_error::deserialize(json)
        .map_err(|error| refused(pointer(&error.path().to_string()), &error.inner().to_string()))
}

/// Converts a path such as `frames[0].w,h` into a JSON pointer.
pub(super) fn pointer(path: &str) -> String {
    let path = path.replace('[', ".").replace(']', "");
    path.split('.').filter(|part| !part.is_empty()).map(|part| format!("/{part}")).collect()
}

/// An error for a field.
pub(super) fn refused(pointer: String, detail: &str) -> FieldError {
    FieldError { pointer, detail: detail.to_owned() }
}
