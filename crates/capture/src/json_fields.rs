//! Fields of a JSON object, read by type. Errors name the file and the path of the field.

use serde_json::{Map, Value};

use crate::CaptureError;

/// An object in a JSON file.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fields<'a> {
    /// The file, for errors.
    pub file: &'a str,
    /// Path of the object in the file, e.g. `frames[3]`; empty for the file's own object.
    pub path: &'a str,
    object: &'a Map<String, Value>,
}

impl<'a> Fields<'a> {
    /// The fields of `value`.
    ///
    /// # Errors
    /// Names `path` if `value` is not an object.
    pub(super) fn new(file: &'a str, path: &'a str, value: &'a Value) -> Result<Self, CaptureError> {
        match value {
            Value::Object(object) => Ok(Self { file, path, object }),
            _ if path.is_empty() => {
                let reason = "must contain a JSON object".to_owned();
                Err(CaptureError::File { file: file.to_owned(), reason })
            }
            _ => Err(CaptureError::at_field(file, path, "must be an object")),
        }
    }

    /// A field's value; `None` if it is absent or null.
    pub(super) fn get(&self, name: &str) -> Option<&'a Value> {
        self.object.get(name).filter(|value| !value.is_null())
    }

    /// The error for a field.
    pub(super) fn error(&self, name: &str, reason: impl Into<String>) -> CaptureError {
        let field = if self.path.is_empty() { name.to_owned() } else { format!("{}.{name}", self.path) };
        CaptureError::at_field(self.file, field, reason)
    }

    /// A finite number, also as a string that contains one.
    ///
    /// # Errors
    /// Names the field if it is anything else.
    pub(super) fn number(&self, name: &str) -> Result<Option<f64>, CaptureError> {
        let Some(value) = self.get(name) else { return Ok(None) };
        number(value).map(Some).ok_or_else(|| self.error(name, "must be a number"))
    }

    /// A string.
    ///
    /// # Errors
    /// Names the field if it is anything else.
    pub(super) fn text(&self, name: &str) -> Result<Option<&'a str>, CaptureError> {
        let Some(value) = self.get(name) else { return Ok(None) };
        value.as_str().map(Some).ok_or_else(|| self.error(name, "must be a string"))
    }

    /// True or false.
    ///
    /// # Errors
    /// Names the field if it is anything else.
    pub(super) fn flag(&self, name: &str) -> Result<Option<bool>, CaptureError> {
        let Some(value) = self.get(name) else { return Ok(None) };
        value.as_bool().map(Some).ok_or_else(|| self.error(name, "must be true or false"))
    }

    /// A list.
    ///
    /// # Errors
    /// Names the field if it is anything else.
    pub(super) fn list(&self, name: &str) -> Result<Option<&'a [Value]>, CaptureError> {
        let Some(value) = self.get(name) else { return Ok(None) };
        value.as_array().map(|list| Some(list.as_slice())).ok_or_else(|| self.error(name, "must be a list"))
    }

    /// A matrix of numbers by rows. A flat list of 9, 12 or 16 numbers has rows of 3, 4 or 4.
    ///
    /// # Errors
    /// Names the field if it is anything else.
    pub(super) fn rows(&self, name: &str) -> Result<Option<Vec<Vec<f64>>>, CaptureError> {
        let Some(list) = self.list(name)? else { return Ok(None) };
        let numbers = |list: &[Value]| list.iter().map(number).collect::<Option<Vec<f64>>>();
        let rows = match list {
            [Value::Array(_), ..] => {
                list.iter().map(|row| numbers(row.as_array()?)).collect::<Option<Vec<_>>>()
            }
            _ => numbers(list).map(|flat| {
                let width = if flat.len() == 9 { 3 } else { 4 };
                flat.chunks(width).map(<[f64]>::to_vec).collect()
            }),
        };
        rows.map(Some).ok_or_else(|| self.error(name, "must be a matrix of numbers"))
    }
}

fn number(value: &Value) -> Option<f64> {
    let number = value.as_f64().or_else(|| value.as_str()?.trim().parse().ok());
    number.filter(|number| number.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn fields_are_read_by_type_and_named_in_errors() {
        let value = json!({"a": 1, "b": "2.5", "c": "x", "d": null, "e": true, "m": [[1, 2], [3, "4"]], "f": [0, 1, 2]});
        let fields = Fields::new("t.json", "frames[3]", &value).unwrap();
        assert_eq!((fields.number("a").unwrap(), fields.number("b").unwrap()), (Some(1.0), Some(2.5)));
        assert_eq!((fields.number("d").unwrap(), fields.number("none").unwrap()), (None, None));
        assert_eq!((fields.text("c").unwrap(), fields.flag("e").unwrap()), (Some("x"), Some(true)));
        assert_eq!(fields.rows("m").unwrap(), Some(vec![vec![1.0, 2.0], vec![3.0, 4.0]]));
        assert_eq!(fields.rows("f").unwrap(), Some(vec![vec![0.0, 1.0, 2.0]]));
        for error in [
            fields.number("c").unwrap_err(),
            fields.flag("c").unwrap_err(),
            fields.list("c").unwrap_err(),
            fields.rows("c").unwrap_err(),
        ] {
            assert_eq!(error.field(), Some("frames[3].c"));
        }
        assert_eq!(fields.text("a").unwrap_err().to_string(), "t.json: frames[3].a: must be a string");
        assert!(Fields::new("t.json", "", &json!([])).is_err());
    }
}
