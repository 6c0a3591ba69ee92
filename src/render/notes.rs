//! What a picture file says of how it was made.

use crate::formats::exr_frame::FrameAttributes;
use crate::render::Tier;
use crate::scene::Camera;

/// What a picture file says of how it was made.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameNotes {
    /// Names the model.
    pub model: String,
    /// Names the light's content.
    pub light: String,
    /// Turn of the light about +Z, degrees counter-clockwise.
    pub rotation_deg: f64,
    /// Exposure of the light, stops.
    pub exposure_ev: f64,
    /// How it was rendered.
    pub tier: Tier,
    /// From where, capture units.
    pub camera: Option<Camera>,
}

impl FrameNotes {
    /// As attributes of an EXR.
    pub(super) fn attributes(&self) -> FrameAttributes {
        let mut texts = vec![
            ("relume:model", self.model.clone()),
            ("relume:light", self.light.clone()),
            ("relume:light_rotation_deg", self.rotation_deg.to_string()),
            ("relume:exposure_ev", self.exposure_ev.to_string()),
            ("relume:tier", self.tier.name().to_owned()),
            ("relume:alpha", "colours are premultiplied, base colour is not".to_owned()),
        ];
        texts.retain(|(_, text)| !text.is_empty());
        let Some(camera) = &self.camera else { return FrameAttributes { texts, world_to_camera: None } };
        let Camera { fx, fy, cx, cy, .. } = camera;
        texts.push(("relume:intrinsics", format!("fx {fx} fy {fy} cx {cx} cy {cy}")));
        texts.push(("relume:camera_axes", "x right, y up, looking along -z (OpenGL)".to_owned()));
        // OpenEXR multiplies rows with matrices: its rows are the columns of ours.
        let columns = camera.to_opengl().inverse().to_cols_array();
        FrameAttributes { texts, world_to_camera: Some(columns.map(|v| v as f32)) }
    }
}
