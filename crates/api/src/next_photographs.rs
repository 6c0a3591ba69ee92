//! Places for further photographs of a capture.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::NerfstudioWorld;
use crate::cameras::CameraSpec;

/// A request for the places from which further photographs would help a model most.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NextPhotographsRequest {
    /// Number of places, 1 to 1000. Omitted: 10.
    #[serde(default = "ten")]
    #[schema(minimum = 1, maximum = 1000)]
    pub count: u32,
    /// Cameras among which to choose, 1 to 2000, as in an export of frames. Omitted: a grid around the subject at the
    /// distance of the photographs.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<Object>)]
    pub path: Option<Value>,
    /// nerfstudio's `dataparser_transforms.json` of the training in which the `camera_path` was made.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub path_world: Option<NerfstudioWorld>,
}

impl Default for NextPhotographsRequest {
    fn default() -> Self {
        Self { count: ten(), path: None, path_world: None }
    }
}

/// Places for further photographs. An export of frames accepts this object as its `path`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct NextPhotographs {
    /// The places, the most helpful first. Each takes the places before it into account.
    pub cameras: Vec<NextPhotographView>,
}

/// A place for a photograph.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct NextPhotographView {
    /// Pose and intrinsics. World: capture units, +Z up.
    pub camera: CameraSpec,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Index of the camera in `path`, or in the grid around the subject.
    pub candidate: u32,
    /// Azimuth, degrees counter-clockwise from the first photograph, seen from above, 0 to 360, as for a thumbnail.
    pub azimuth_deg: f64,
    /// Elevation, degrees above the horizon, -90 to 90, as for a thumbnail.
    pub elevation_deg: f64,
    /// Angle to the nearest photograph or earlier place, seen from the subject, degrees.
    pub nearest_deg: f64,
    /// Mean of 1 - confidence over what the camera shows, 0 to 1. A place with a larger value helps more.
    pub lack_of_confidence: f64,
}

fn ten() -> u32 {
    10
}
