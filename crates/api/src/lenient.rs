//! Forms of numbers and matrices that other programs write.

use serde::de::Error;
use serde::{Deserialize, Deserializer};

/// A whole number of pixels, also as a floating-point number, e.g. 512.0, as programs without integers write it.
///
/// # Errors
/// For other numbers.
pub fn pixels<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    let number = serde_json::Number::deserialize(deserializer)?;
    whole(&number).map_err(D::Error::custom)
}

/// As [`pixels`], where the number may be missing or null.
///
/// # Errors
/// As [`pixels`].
pub fn optional_pixels<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u32>, D::Error> {
    let number = Option::<serde_json::Number>::deserialize(deserializer)?;
    number.as_ref().map(whole).transpose().map_err(D::Error::custom)
}

fn whole(number: &serde_json::Number) -> Result<u32, String> {
    let refused = || format!("must be a whole number of pixels, at least 0, got {number}");
    match number.as_f64() {
        Some(v) if v.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&v) => Ok(v as u32),
        _ => Err(refused()),
    }
}

/// The rows of a matrix of 4x4: four rows, or 16 numbers row by row.
///
/// # Errors
/// For other numbers of numbers.
pub fn matrix<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[[f64; 4]; 4]>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Form {
        Rows([[f64; 4]; 4]),
        Flat([f64; 16]),
    }
    let rows = |form| match form {
        Form::Rows(rows) => rows,
        Form::Flat(flat) => std::array::from_fn(|row| std::array::from_fn(|k| flat[4 * row + k])),
    };
    match Option::<serde_json::Value>::deserialize(deserializer)? {
        None => Ok(None),
        Some(value) => Form::deserialize(value).map(|form| Some(rows(form))).map_err(|_| {
            D::Error::custom("must be a matrix of 4x4 numbers: 4 rows of 4, or 16 numbers row by row")
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[derive(Debug, Deserialize, PartialEq)]
    struct Sizes {
        #[serde(deserialize_with = "pixels")]
        width: u32,
        #[serde(default, deserialize_with = "optional_pixels")]
        height: Option<u32>,
        #[serde(default, deserialize_with = "matrix")]
        pose: Option<[[f64; 4]; 4]>,
    }

    fn read(json: serde_json::Value) -> Result<Sizes, String> {
        serde_json::from_value(json).map_err(|error| error.to_string())
    }

    #[test]
    fn sizes_may_be_floats_of_whole_numbers_only() {
        let sizes = read(json!({ "width": 512.0, "height": 3 })).unwrap();
        assert_eq!((sizes.width, sizes.height), (512, Some(3)));
        assert_eq!(read(json!({ "width": 1, "height": null })).unwrap().height, None);
        for bad in [json!(1.5), json!(-1), json!(1e20), json!("512")] {
            assert!(read(json!({ "width": bad })).is_err(), "{bad}");
        }
        assert!(read(json!({ "width": 1.5 })).unwrap_err().contains("whole number of pixels"));
    }

    #[test]
    fn matrices_may_be_rows_or_16_numbers() {
        let flat: Vec<f64> = (0..16).map(f64::from).collect();
        let rows: Vec<&[f64]> = flat.chunks(4).collect();
        let by_rows = read(json!({ "width": 1, "pose": rows })).unwrap();
        assert_eq!(by_rows, read(json!({ "width": 1, "pose": flat })).unwrap());
        assert_eq!(by_rows.pose.unwrap()[1], [4.0, 5.0, 6.0, 7.0]);
        for bad in [json!(flat[..12]), json!([rows[0], rows[1], rows[2]]), json!("identity")] {
            let error = read(json!({ "width": 1, "pose": bad })).unwrap_err();
            assert!(error.contains("4 rows of 4, or 16 numbers"), "{error}");
        }
    }
}
