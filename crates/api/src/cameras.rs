//! Cameras of a capture's photographs and cameras of render requests.

use glam::{DMat4, DVec3};
use serde::{Deserialize, Serialize};

use crate::lenient;
use crate::problem::FieldError;
use relume_scene::{Camera, CameraError};

/// Convention of camera poses.
///
/// `opengl`: `camera_to_world` with x right, y up, looking along -z, as in Blender and nerfstudio. `opencv`:
/// `camera_to_world` with `axes: opencv`, x right, y down, looking along +z. `colmap`: the field `colmap`
/// with a world-to-camera quaternion and translation.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[derive(utoipa::ToSchema)]
pub enum CameraConvention {
    /// `camera_to_world`, x right, y up, looking along -z, as in Blender and nerfstudio.
    #[default]
    Opengl,
    /// `camera_to_world` with `axes: opencv`, x right, y down, looking along +z.
    Opencv,
    /// `colmap`: world-to-camera quaternion and translation.
    Colmap,
}

impl CameraConvention {
    /// Name in requests.
    pub fn name(self) -> &'static str {
        match self {
            Self::Opengl => "opengl",
            Self::Opencv => "opencv",
            Self::Colmap => "colmap",
        }
    }
}

/// The cameras of a capture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CaptureCameras {
    /// Convention of the poses.
    pub convention: CameraConvention,
    /// One camera per photograph, in the order of the capture.
    pub cameras: Vec<CapturedCamera>,
}

/// Camera of a photograph after removal of lens distortion.
///
/// A render request accepts `camera`, `width` and `height` unchanged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CapturedCamera {
    /// Name of the photograph in the capture.
    pub name: String,
    /// True if trainings exclude the photograph and use it to evaluate the model.
    pub held_out: bool,
    /// Width of the photograph, pixels.
    pub width: u32,
    /// Height of the photograph, pixels.
    pub height: u32,
    /// Rotation of the light about +Z relative to the other photographs, degrees, counter-clockwise seen from
    /// above.
    pub light_rotation_deg: f64,
    /// Pose and intrinsics. World: capture units, +Z up.
    pub camera: CameraSpec,
}

/// A camera: exactly one of `look_at`, `camera_to_world` and `colmap`.
///
/// `camera_to_world` and `colmap` also need either `fov_y_deg` or `intrinsics`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CameraSpec {
    /// Rows of the camera-to-world matrix, capture units. The last row is 0 0 0 1. The 16 numbers may also be one
    /// list, row by row. Programs that store matrices by columns, such as three.js, must transpose them.
    #[serde(skip_serializing_if = "Option::is_none", default, deserialize_with = "lenient::matrix")]
    pub camera_to_world: Option<[[f64; 4]; 4]>,
    /// Axes of `camera_to_world`. Omitted: `opengl`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(inline)]
    pub axes: Option<CameraAxes>,
    /// Pose in COLMAP's convention.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub colmap: Option<ColmapPose>,
    /// Vertical field of view, degrees, more than 0 and less than 180. Allowed only with `camera_to_world` or
    /// `colmap`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub fov_y_deg: Option<f64>,
    /// Intrinsics in pixels of the requested size. Allowed only with `camera_to_world` or `colmap`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub intrinsics: Option<IntrinsicsSpec>,
    /// Camera by position and target.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub look_at: Option<LookAtSpec>,
}

impl CameraSpec {
    /// Converts to the camera of an image of `size`: width and height, pixels.
    ///
    /// # Errors
    /// Names the invalid field. The pointer is relative to this object; it is empty if the combination of
    /// fields is invalid.
    pub fn camera(&self, size: (u32, u32)) -> Result<Camera, FieldError> {
        if self.axes.is_some() && self.camera_to_world.is_none() {
            return Err(refused("/axes", "is allowed only with camera_to_world"));
        }
        match (&self.look_at, &self.camera_to_world, &self.colmap) {
            (Some(look), None, None) => {
                if self.fov_y_deg.is_some() || self.intrinsics.is_some() {
                    let detail = "look_at has its own fov_y_deg; fov_y_deg and intrinsics are allowed only with camera_to_world or colmap";
                    return Err(refused("", detail));
                }
                let [eye, target, up] = [look.eye, look.target, look.up].map(DVec3::from_array);
                Camera::look_at(eye, target, up, look.fov_y_deg.to_radians(), size)
                    .map_err(|error| named_as_here("/look_at", error))
            }
            (None, Some(rows), None) => {
                let (focal, centre) = self.lens(size)?;
                let matrix = DMat4::from_cols_array_2d(rows).transpose();
                let made = match self.axes.unwrap_or_default() {
                    CameraAxes::Opengl => Camera::from_opengl(&matrix, size, focal, centre),
                    CameraAxes::Opencv => Camera::from_opencv(&matrix, size, focal, centre),
                };
                made.map_err(|error| named_as_here("", error))
            }
            (None, None, Some(pose)) => {
                let (focal, centre) = self.lens(size)?;
                Camera::from_colmap(pose.qvec, pose.tvec, size, focal, centre)
                    .map_err(|error| named_as_here("", error))
            }
            _ => Err(refused("", "must have exactly one of look_at, camera_to_world and colmap")),
        }
    }

    /// Focal lengths and principal point in pixels.
    fn lens(&self, (width, height): (u32, u32)) -> Result<(Pair, Pair), FieldError> {
        match (&self.intrinsics, self.fov_y_deg) {
            (Some(i), None) => Ok(((i.fx, i.fy), (i.cx, i.cy))),
            (None, Some(fov)) if fov > 0.0 && fov < 180.0 => {
                let focal = 0.5 * f64::from(height) / (0.5 * fov.to_radians()).tan();
                Ok(((focal, focal), (0.5 * f64::from(width), 0.5 * f64::from(height))))
            }
            (None, Some(_)) => Err(refused("/fov_y_deg", "must be more than 0 and less than 180")),
            _ => Err(refused("", "must have either fov_y_deg or intrinsics")),
        }
    }

    /// Describes `camera` in a convention.
    pub fn of(camera: &Camera, convention: CameraConvention) -> Self {
        let Camera { fx, fy, cx, cy, .. } = *camera;
        let spec = Self { intrinsics: Some(IntrinsicsSpec { fx, fy, cx, cy }), ..Self::default() };
        let rows = |matrix: glam::DMat4| Some(matrix.transpose().to_cols_array_2d());
        match convention {
            CameraConvention::Opengl => Self { camera_to_world: rows(camera.to_opengl()), ..spec },
            CameraConvention::Opencv => {
                Self { camera_to_world: rows(camera.to_opencv()), axes: Some(CameraAxes::Opencv), ..spec }
            }
            CameraConvention::Colmap => {
                let (qvec, tvec) = camera.to_colmap();
                Self { colmap: Some(ColmapPose { qvec, tvec }), ..spec }
            }
        }
    }
}

type Pair = (f64, f64);

fn refused(pointer: &str, detail: &str) -> FieldError {
    FieldError { pointer: pointer.to_owned(), detail: detail.to_owned() }
}

/// Translates field names of [`Camera`] to field names of [`CameraSpec`].
fn named_as_here(base: &str, error: CameraError) -> FieldError {
    let pointer = match error.field {
        "transform_matrix" => format!("{base}/camera_to_world"),
        field @ ("qvec" | "tvec") => format!("{base}/colmap/{field}"),
        "fov_y" => format!("{base}/fov_y_deg"),
        field @ ("fx" | "fy" | "cx" | "cy") => format!("{base}/intrinsics/{field}"),
        field => format!("{base}/{field}"),
    };
    FieldError { pointer, detail: error.reason }
}

/// Axes of a camera. `opengl`: x right, y up, looking along -z. `opencv`: x right, y down, looking along +z.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[derive(utoipa::ToSchema)]
pub enum CameraAxes {
    /// x right, y up, looking along -z.
    #[default]
    Opengl,
    /// x right, y down, looking along +z.
    Opencv,
}

/// World-to-camera pose in OpenCV axes, `x_camera = R(qvec) x_world + tvec`, as in COLMAP's `images.txt`.
///
/// The world is the world of the capture: COLMAP's world, rotated so that the up direction of the
/// capture is +Z.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ColmapPose {
    /// Quaternion w, x, y, z.
    pub qvec: [f64; 4],
    /// Translation, capture units.
    pub tvec: [f64; 3],
}

/// Pinhole intrinsics, pixels. Pixel centres lie at +0.5.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct IntrinsicsSpec {
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point x, pixels.
    pub cx: f64,
    /// Principal point y, pixels.
    pub cy: f64,
}

/// Camera by position and target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LookAtSpec {
    /// Position of the camera, capture units.
    pub eye: [f64; 3],
    /// Point in the centre of the image, capture units.
    pub target: [f64; 3],
    /// Up direction. Omitted: world +Z.
    #[serde(default = "world_up")]
    pub up: [f64; 3],
    /// Vertical field of view, degrees, more than 0 and less than 180.
    pub fov_y_deg: f64,
}

fn world_up() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transposed_camera_matrix_is_refused_by_name() {
        let size = (64, 48);
        let camera = Camera::look_at(DVec3::new(3.0, 1.0, 1.0), DVec3::ZERO, DVec3::Z, 0.7, size).unwrap();
        for convention in [CameraConvention::Opengl, CameraConvention::Opencv] {
            let spec = CameraSpec::of(&camera, convention);
            assert!(spec.camera(size).is_ok(), "the control");
            let rows = DMat4::from_cols_array_2d(&spec.camera_to_world.unwrap());
            // The 16 numbers of a column-major program, taken as rows.
            let columns = rows.transpose().to_cols_array_2d();
            let error = CameraSpec { camera_to_world: Some(columns), ..spec }.camera(size).unwrap_err();
            assert_eq!(error.pointer, "/camera_to_world");
            assert!(error.detail.contains("the last row must be 0 0 0 1"), "{error:?}");
            assert!(error.detail.contains("looks transposed"), "{error:?}");
        }
    }
}
