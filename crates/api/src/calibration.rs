//! Calibrations of models by a surface of known reflectance.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};

use relume_spec::training::GreyCard;

/// A calibration of a model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewCalibration {
    /// A surface of known reflectance in a photograph of the model's capture. It must be a part of the model, and may lie in a
    /// shadow.
    pub patch: Patch,
    /// Linear reflectance of the surface, 0.01 to 1: one number, or red, green and blue (Rec.709). A grey card has 0.18, matte white
    /// paper about 0.9.
    #[serde(deserialize_with = "reflectance")]
    #[schema(schema_with = reflectance_schema)]
    pub reflectance: [f32; 3],
}

/// Rectangle of a photograph.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Patch {
    /// The photograph: its path in the capture, or the end of that path.
    pub photo: String,
    /// Left edge, in pixels of the stored photograph.
    #[serde(deserialize_with = "crate::lenient::pixels")]
    pub x: u32,
    /// Upper edge, in pixels of the stored photograph.
    #[serde(deserialize_with = "crate::lenient::pixels")]
    pub y: u32,
    /// Width in pixels, at least 1.
    #[serde(deserialize_with = "crate::lenient::pixels")]
    #[schema(minimum = 1)]
    pub width: u32,
    /// Height in pixels, at least 1.
    #[serde(deserialize_with = "crate::lenient::pixels")]
    #[schema(minimum = 1)]
    pub height: u32,
}

impl From<Patch> for GreyCard {
    fn from(Patch { photo, x, y, width, height }: Patch) -> Self {
        Self { photo, x, y, width, height, reflectance: None }
    }
}

/// The calibration of a model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CalibrationView {
    /// Known linear reflectance of the surface, by channel.
    pub reflectance: [f32; 3],
    /// Mean albedo of the model on the surface before the calibration.
    pub albedo_before: [f32; 3],
    /// Factor on the albedo of the model, by channel. The light was divided by it.
    pub scale: [f32; 3],
    /// Product of the factors of all calibrations since the training, which `DELETE` undoes. Absent for a calibration that was a
    /// part of the training.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Vec<f32>>)]
    pub total_scale: Option<[f32; 3]>,
    /// The surface. Absent for a calibration that was a part of the training.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub patch: Option<Patch>,
}

impl CalibrationView {
    /// The calibration in a model card; `None` if there is none.
    pub fn of_card(card: &serde_json::Value) -> Option<Self> {
        serde_json::from_value(card.get("calibration")?.clone()).ok()
    }
}

fn reflectance<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f32; 3], D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Form {
        Grey(f32),
        Rgb([f32; 3]),
    }
    let value = serde_json::Value::deserialize(deserializer)?;
    match Form::deserialize(value) {
        Ok(Form::Grey(grey)) => Ok([grey; 3]),
        Ok(Form::Rgb(rgb)) => Ok(rgb),
        Err(_) => Err(D::Error::custom("must be a number, or three numbers for red, green and blue")),
    }
}

fn reflectance_schema() -> utoipa::openapi::schema::Schema {
    use utoipa::openapi::schema::{ArrayBuilder, ObjectBuilder, OneOfBuilder, Type};
    let number = || ObjectBuilder::new().schema_type(Type::Number).minimum(Some(0.01)).maximum(Some(1.0));
    let rgb = ArrayBuilder::new().items(number()).min_items(Some(3)).max_items(Some(3));
    let description = "Linear reflectance of the surface, 0.01 to 1: one number, or red, green and blue (Rec.709). A grey card has \
                       0.18, matte white paper about 0.9.";
    OneOfBuilder::new().item(number()).item(rgb).description(Some(description)).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn read(reflectance: serde_json::Value) -> Result<NewCalibration, serde_json::Error> {
        let patch = json!({ "photo": "a.jpg", "x": 1, "y": 2.0, "width": 3, "height": 4 });
        serde_json::from_value(json!({ "patch": patch, "reflectance": reflectance }))
    }

    #[test]
    fn reflectance_is_a_number_or_three() {
        assert_eq!(read(json!(0.18)).unwrap().reflectance, [0.18; 3]);
        assert_eq!(read(json!([0.1, 0.2, 0.3])).unwrap().reflectance, [0.1, 0.2, 0.3]);
        for bad in [json!("white"), json!([0.1, 0.2]), json!(null), json!({ "r": 1 })] {
            assert!(read(bad.clone()).unwrap_err().to_string().contains("three numbers"), "{bad}");
        }
        let sent = serde_json::to_value(read(json!(0.5)).unwrap()).unwrap();
        assert_eq!(sent, json!({ "patch": sent["patch"], "reflectance": [0.5, 0.5, 0.5] }));
        assert_eq!(serde_json::from_value::<NewCalibration>(sent).unwrap(), read(json!(0.5)).unwrap());
    }

    #[test]
    fn calibration_of_a_training_has_no_patch() {
        let trained = json!({ "reflectance": [0.5, 0.5, 0.5], "albedo_before": [0.25, 0.25, 0.25], "scale": [2.0, 2.0, 2.0] });
        let card = json!({ "calibration": trained });
        let view = CalibrationView::of_card(&card).unwrap();
        assert_eq!((view.total_scale, &view.patch), (None, &None));
        assert_eq!(serde_json::to_value(view).unwrap(), trained);
        for none in [json!({}), json!({ "calibration": { "error": "too dark" } })] {
            assert_eq!(CalibrationView::of_card(&none), None, "{none}");
        }
    }
}
