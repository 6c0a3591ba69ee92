//! Cameras: those of a capture's photographs, and those that frames are rendered for.

use glam::{DMat4, DVec3};
use serde::{Deserialize, Serialize};

use crate::api::problem::FieldError;
use crate::scene::{Camera, CameraError};

/// How a camera's pose is written.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub enum CameraConvention {
    /// `camera_to_world`, x right, y up, looking along -z: also that of Blender and nerfstudio.
    #[default]
    Opengl,
    /// `camera_to_world` with `axes: opencv`, x right, y down, looking along +z.
    Opencv,
    /// `colmap`: world-to-camera quaternion and translation.
    Colmap,
}

impl CameraConvention {
    /// What it is called in requests.
    pub fn name(self) -> &'static str {
        match self {
            Self::Opengl => "opengl",
            Self::Opencv => "opencv",
            Self::Colmap => "colmap",
        }
    }
}

/// The cameras of a capture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct CaptureCameras {
    /// How their poses are written.
    pub convention: CameraConvention,
    /// One for each photograph, in the order in which the capture names them.
    pub cameras: Vec<CapturedCamera>,
}

/// The camera of a photograph, distortion removed. `camera`, `width` and `height` are what a render takes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub struct CapturedCamera {
    /// The photograph's name in the capture.
    pub name: String,
    /// Whether trainings leave it out, to be judged by it.
    pub held_out: bool,
    /// Width of the photograph, pixels.
    pub width: u32,
    /// Height of the photograph, pixels.
    pub height: u32,
    /// Turn of the light about +Z against the other photographs, degrees counter-clockwise seen from above.
    pub light_rotation_deg: f64,
    /// Pose and intrinsics; world: capture units, +Z up.
    pub camera: CameraSpec,
}

/// A camera: one of `look_at`, `camera_to_world` and `colmap`; the last two with `fov_y_deg` or `intrinsics`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct CameraSpec {
    /// Rows of the camera-to-world matrix, capture units.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub camera_to_world: Option<[[f64; 4]; 4]>,
    /// Axes of `camera_to_world`: `opengl` when absent.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[cfg_attr(feature = "server", schema(inline))]
    pub axes: Option<CameraAxes>,
    /// A pose as COLMAP writes it.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub colmap: Option<ColmapPose>,
    /// Vertical field of view, degrees, with `camera_to_world` or `colmap`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub fov_y_deg: Option<f64>,
    /// Pixels of the requested size, with `camera_to_world` or `colmap`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub intrinsics: Option<IntrinsicsSpec>,
    /// A camera by what it looks at.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub look_at: Option<LookAtSpec>,
}

impl CameraSpec {
    /// The camera of a picture of `size`, width and height in pixels.
    ///
    /// # Errors
    /// The pointer leads from this object to the field at fault; it is empty where fields do not go together.
    pub fn camera(&self, size: (u32, u32)) -> Result<Camera, FieldError> {
        if self.axes.is_some() && self.camera_to_world.is_none() {
            return Err(refused("/axes", "goes with camera_to_world"));
        }
        match (&self.look_at, &self.camera_to_world, &self.colmap) {
            (Some(look), None, None) => {
                if self.fov_y_deg.is_some() || self.intrinsics.is_some() {
                    let detail =
                        "look_at brings its own fov_y_deg; intrinsics go with camera_to_world or colmap";
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
            _ => Err(refused("", "must have one of look_at, camera_to_world and colmap")),
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
            (None, Some(_)) => Err(refused("/fov_y_deg", "must lie strictly between 0 and 180")),
            _ => Err(refused("", "must have either fov_y_deg or intrinsics")),
        }
    }

    /// A camera, written so.
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

/// Translates the field names of [`Camera`] to those of [`CameraSpec`].
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

/// The axes of a camera.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
pub enum CameraAxes {
    /// x right, y up, looking along -z.
    #[default]
    Opengl,
    /// x right, y down, looking along +z.
    Opencv,
}

/// World to camera in OpenCV axes, `x_camera = R(qvec) x_world + tvec`, as in COLMAP's `images.txt`. The world is that of the
/// capture: COLMAP's own, turned so that the mean up of the photographs is +Z.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct ColmapPose {
    /// Quaternion w, x, y, z.
    pub qvec: [f64; 4],
    /// Capture units.
    pub tvec: [f64; 3],
}

/// A pinhole in pixels; pixel centres lie at +0.5.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct IntrinsicsSpec {
    /// Focal length along x.
    pub fx: f64,
    /// Focal length along y.
    pub fy: f64,
    /// Principal point x.
    pub cx: f64,
    /// Principal point y.
    pub cy: f64,
}

/// A camera by what it looks at, capture units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(deny_unknown_fields)]
pub struct LookAtSpec {
    /// Where it stands.
    pub eye: [f64; 3],
    /// What it looks at.
    pub target: [f64; 3],
    /// What is up; world +Z when absent.
    #[serde(default = "world_up")]
    pub up: [f64; 3],
    /// Vertical field of view, degrees.
    pub fov_y_deg: f64,
}

fn world_up() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}
