//! Pinhole cameras. Inside Relume every camera uses OpenCV axes (x right, y down, z forward) and stores world-to-camera.
//! nerfstudio, Blender and, by default, the API use camera-to-world in OpenGL axes.

use glam::{DMat3, DMat4, DQuat, DVec3, DVec4};

/// A posed pinhole camera without distortion.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Camera {
    /// Image width in pixels, at least 1.
    pub width: u32,
    /// Image height in pixels, at least 1.
    pub height: u32,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point x, pixels; pixel centres lie at +0.5.
    pub cx: f64,
    /// Principal point y, pixels.
    pub cy: f64,
    /// World-to-camera rotation (rows are the camera's right, down and forward axes in the world).
    pub rotation: DMat3,
    /// World-to-camera translation, capture units: `x_cam = rotation * x_world + translation`.
    pub translation: DVec3,
}

/// Accepted focal lengths, pixels: 179.99999 degrees on one pixel to a thousandth of a second of arc on 8k.
const FOCAL_LENGTHS: std::ops::RangeInclusive<f64> = 1e-7..=1e13;
/// Largest distance of a principal point from the image's corner, pixels.
const MAX_PRINCIPAL_POINT: f64 = 1e9;
/// Largest deviation of the last row of a pose from 0 0 0 1: the rounding of programs that compute with 32-bit floats.
const LAST_ROW_TOLERANCE: f64 = 1e-6;

/// Why a camera was refused. `field` is the caller's name of the value at fault.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field}: {reason}")]
pub struct CameraError {
    /// The field at fault, e.g. `transform_matrix` or `fov_y_deg`.
    pub field: &'static str,
    /// The reason.
    pub reason: String,
}

impl CameraError {
    fn new(field: &'static str, reason: impl Into<String>) -> Self {
        Self { field, reason: reason.into() }
    }
}

impl Camera {
    /// From a camera-to-world matrix in OpenGL/Blender axes (x right, y up, looking along -z).
    ///
    /// The upper 3x3 may carry a uniform scale, which is removed.
    ///
    /// # Errors
    /// Names `transform_matrix` when it has a non-finite entry, is singular, mirrored or not a similarity, or when its last row is
    /// not 0 0 0 1.
    pub fn from_opengl(
        c2w: &DMat4,
        (width, height): (u32, u32),
        (fx, fy): (f64, f64),
        (cx, cy): (f64, f64),
    ) -> Result<Self, CameraError> {
        let bad = |reason: &str| Err(CameraError::new("transform_matrix", reason));
        if !c2w.to_cols_array().iter().all(|v| v.is_finite()) {
            return bad("has a value that is not finite");
        }
        let linear = DMat3::from_mat4(*c2w);
        let det = linear.determinant();
        let scale = det.abs().cbrt();
        if scale < 1e-12 {
            return bad("is singular (determinant 0)");
        }
        if det < 0.0 {
            return bad("mirrors space (negative determinant)");
        }
        let axes = linear * (1.0 / scale);
        let skew = (axes * axes.transpose() - DMat3::IDENTITY).to_cols_array();
        if skew.iter().any(|v| v.abs() > 1e-3) {
            return bad("is not a rotation: its columns are not orthogonal and of one length");
        }
        Self::check_last_row(c2w)?;
        let right = axes.x_axis.normalize();
        let up = (axes.y_axis - right * right.dot(axes.y_axis)).normalize();
        let back = right.cross(up);
        let rotation = DMat3::from_cols(right, -up, -back).transpose();
        let centre = c2w.w_axis.truncate();
        Self { width, height, fx, fy, cx, cy, rotation, translation: -(rotation * centre) }.validated()
    }

    /// Refuses a camera-to-world matrix whose last row is not 0 0 0 1: it is no pose, and its last column is not the centre of the
    /// camera. A column-major list of numbers that was read row by row is the usual cause.
    ///
    /// # Errors
    /// Names `transform_matrix`.
    pub fn check_last_row(c2w: &DMat4) -> Result<(), CameraError> {
        let is_unit = |row: DVec4| row.abs_diff_eq(DVec4::W, LAST_ROW_TOLERANCE);
        let last = c2w.row(3);
        if is_unit(last) {
            return Ok(());
        }
        let [x, y, z, w] = last.to_array();
        let hint = match is_unit(c2w.w_axis) {
            true => "; the matrix looks transposed (column-major, as three.js writes it)",
            false => "",
        };
        Err(CameraError::new(
            "transform_matrix",
            format!("the last row must be 0 0 0 1, got {x} {y} {z} {w}{hint}"),
        ))
    }

    /// From a camera-to-world matrix in OpenCV axes (x right, y down, looking along +z).
    ///
    /// # Errors
    /// As [`Camera::from_opengl`].
    pub fn from_opencv(
        c2w: &DMat4,
        size: (u32, u32),
        focal: (f64, f64),
        centre: (f64, f64),
    ) -> Result<Self, CameraError> {
        Self::check_last_row(c2w)?;
        Self::from_opengl(&between_axes(c2w), size, focal, centre)
    }

    /// From a pose as COLMAP writes it in `images.txt`: `x_cam = R(q) x_world + t`, the quaternion as w, x, y, z of any length.
    ///
    /// # Errors
    /// Names `qvec` or `tvec` when they define no pose, or the intrinsic that is out of range.
    pub fn from_colmap(
        [w, x, y, z]: [f64; 4],
        tvec: [f64; 3],
        (width, height): (u32, u32),
        (fx, fy): (f64, f64),
        (cx, cy): (f64, f64),
    ) -> Result<Self, CameraError> {
        let largest = [w, x, y, z].into_iter().map(f64::abs).fold(0.0, f64::max);
        if !([w, x, y, z].iter().all(|v| v.is_finite()) && largest > 1e-12) {
            return Err(CameraError::new("qvec", "is no rotation"));
        }
        if !tvec.iter().all(|v| v.is_finite()) {
            return Err(CameraError::new("tvec", "has a value that is not finite"));
        }
        // The largest component divides first: the square of a very long quaternion would overflow.
        let q = (DQuat::from_xyzw(x, y, z, w) * (1.0 / largest)).normalize();
        let (rotation, translation) = (DMat3::from_quat(q), DVec3::from(tvec));
        Self { width, height, fx, fy, cx, cy, rotation, translation }.validated()
    }

    /// A camera with centre `eye` that looks at `target` with world up `up`; `fov_y` in radians, square pixels,
    /// principal point at the image centre.
    ///
    /// # Errors
    /// Names `eye`, `target`, `up` or `fov_y` when they do not define a view.
    pub fn look_at(
        eye: DVec3,
        target: DVec3,
        up: DVec3,
        fov_y: f64,
        (width, height): (u32, u32),
    ) -> Result<Self, CameraError> {
        if !(fov_y > 0.0 && fov_y < std::f64::consts::PI) {
            return Err(CameraError::new("fov_y", "must lie strictly between 0 and 180 degrees"));
        }
        let forward = (target - eye).try_normalize();
        let forward =
            forward.ok_or_else(|| CameraError::new("target", "coincides with eye or is not finite"))?;
        // A view along the up axis leaves roll undefined: any perpendicular axis serves, provided it is always the same.
        let right = forward.cross(up).try_normalize().unwrap_or_else(|| forward.any_orthonormal_vector());
        let down = forward.cross(right);
        let rotation = DMat3::from_cols(right, down, forward).transpose();
        let focal = 0.5 * f64::from(height) / (0.5 * fov_y).tan();
        Self {
            width,
            height,
            fx: focal,
            fy: focal,
            cx: 0.5 * f64::from(width),
            cy: 0.5 * f64::from(height),
            rotation,
            translation: -(rotation * eye),
        }
        .validated()
    }

    /// The camera unchanged, when every field is valid.
    ///
    /// # Errors
    /// Names the first field that is not finite, not positive where it must be, or out of range.
    pub fn validated(self) -> Result<Self, CameraError> {
        if self.width == 0 || self.height == 0 {
            return Err(CameraError::new("width,height", "must be at least 1 pixel"));
        }
        for (field, value) in [("fx", self.fx), ("fy", self.fy)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(CameraError::new(field, format!("focal length must be positive, got {value}")));
            }
            if !FOCAL_LENGTHS.contains(&value) {
                let reason = format!("focal length must be 1e-7 to 1e13 pixels, got {value:e}");
                return Err(CameraError::new(field, reason));
            }
        }
        for (field, value) in [("cx", self.cx), ("cy", self.cy)] {
            if !value.is_finite() {
                return Err(CameraError::new(field, "principal point must be finite"));
            }
            if value.abs() > MAX_PRINCIPAL_POINT {
                return Err(CameraError::new(
                    field,
                    format!("principal point must be within 1e9 pixels, got {value:e}"),
                ));
            }
        }
        let pose = self.rotation.to_cols_array();
        if !(pose.iter().all(|v| v.is_finite()) && self.translation.is_finite()) {
            return Err(CameraError::new("transform_matrix", "has a value that is not finite"));
        }
        Ok(self)
    }

    /// The camera's centre in the world, capture units.
    pub fn centre(&self) -> DVec3 {
        -(self.rotation.transpose() * self.translation)
    }

    /// Unit vector of the optical axis in the world.
    pub fn forward(&self) -> DVec3 {
        self.rotation.row(2)
    }

    /// Unit ray direction in the world through the centre of pixel (`x`, `y`).
    pub fn ray(&self, x: u32, y: u32) -> DVec3 {
        let u = (f64::from(x) + 0.5 - self.cx) / self.fx;
        let v = (f64::from(y) + 0.5 - self.cy) / self.fy;
        (self.rotation.transpose() * DVec3::new(u, v, 1.0)).normalize()
    }

    /// The same view at another image size, with scaled intrinsics.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let sx = f64::from(width) / f64::from(self.width);
        let sy = f64::from(height) / f64::from(self.height);
        Self {
            width,
            height,
            fx: self.fx * sx,
            fy: self.fy * sy,
            cx: self.cx * sx,
            cy: self.cy * sy,
            ..*self
        }
    }

    /// The camera after the world moved by `x' = scale * (x + offset)`.
    #[must_use]
    pub fn in_normalised_world(&self, scale: f64, offset: DVec3) -> Self {
        let centre = (self.centre() + offset) * scale;
        Self { translation: -(self.rotation * centre), ..*self }
    }

    /// Camera-to-world matrix in OpenGL/Blender axes, the inverse of [`Camera::from_opengl`].
    pub fn to_opengl(&self) -> DMat4 {
        let r = self.rotation;
        let mut m = DMat4::from_mat3(DMat3::from_cols(r.row(0), -r.row(1), -r.row(2)));
        m.w_axis = self.centre().extend(1.0);
        m
    }

    /// Camera-to-world matrix in OpenCV axes, the inverse of [`Camera::from_opencv`].
    pub fn to_opencv(&self) -> DMat4 {
        between_axes(&self.to_opengl())
    }

    /// World-to-camera quaternion (w, x, y, z; w not negative) and translation, the inverse of [`Camera::from_colmap`].
    pub fn to_colmap(&self) -> ([f64; 4], [f64; 3]) {
        let q = DQuat::from_mat3(&self.rotation).normalize();
        let q = if q.w < 0.0 { -q } else { q };
        ([q.w, q.x, q.y, q.z], self.translation.to_array())
    }
}

/// Converts a camera-to-world matrix between OpenGL and OpenCV axes, in either direction: y and z change sign.
fn between_axes(c2w: &DMat4) -> DMat4 {
    DMat4::from_cols(c2w.x_axis, -c2w.y_axis, -c2w.z_axis, c2w.w_axis)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Camera {
        let eye = DVec3::new(1.0, -3.0, 2.0);
        Camera::look_at(eye, DVec3::ZERO, DVec3::Z, 0.7, (64, 48)).unwrap()
    }

    #[test]
    fn opengl_matrix_round_trips() {
        let cam = example();
        let back =
            Camera::from_opengl(&cam.to_opengl(), (64, 48), (cam.fx, cam.fy), (cam.cx, cam.cy)).unwrap();
        assert!((back.translation - cam.translation).length() < 1e-12);
        assert!((back.rotation - cam.rotation).to_cols_array().iter().all(|v| v.abs() < 1e-12));
    }

    #[test]
    fn camera_round_trips_through_every_pose_convention() {
        let cam = example();
        let (size, focal, centre) = ((64, 48), (cam.fx, cam.fy), (cam.cx, cam.cy));
        let opengl = Camera::from_opengl(&cam.to_opengl(), size, focal, centre).unwrap();
        assert_eq!(Camera::from_opencv(&cam.to_opencv(), size, focal, centre).unwrap(), opengl);
        assert_ne!(Camera::from_opencv(&cam.to_opengl(), size, focal, centre), Ok(opengl), "the control");
        let forward = cam.to_opencv().z_axis.truncate();
        assert!((forward - cam.forward()).length() < 1e-12, "OpenCV looks along +z");
        let (qvec, tvec) = cam.to_colmap();
        for length in [1.0, 1e-9, 1e200] {
            let back = Camera::from_colmap(qvec.map(|v| v * length), tvec, size, focal, centre).unwrap();
            assert!((back.translation - cam.translation).length() < 1e-12);
            let off = (back.rotation - cam.rotation).to_cols_array();
            assert!(off.iter().all(|v| v.abs() < 1e-12), "{length}: {off:?}");
        }
        for (qvec, tvec, field) in [
            ([0.0; 4], tvec, "qvec"),
            ([f64::NAN, 0.0, 0.0, 1.0], tvec, "qvec"),
            (qvec, [f64::INFINITY, 0.0, 0.0], "tvec"),
        ] {
            assert_eq!(Camera::from_colmap(qvec, tvec, size, focal, centre).unwrap_err().field, field);
        }
    }

    #[test]
    fn look_at_camera_faces_the_target_and_keeps_up_direction() {
        let cam = example();
        assert!((cam.forward() - (-cam.centre()).normalize()).length() < 1e-12);
        let above = cam.rotation * DVec3::Z;
        assert!(above.y < 0.0, "the world's up must point to smaller image rows");
    }

    #[test]
    fn singular_and_nan_poses_are_refused_by_field() {
        for m in [DMat4::ZERO, DMat4::from_cols_array(&[f64::NAN; 16])] {
            let err = Camera::from_opengl(&m, (4, 4), (1.0, 1.0), (2.0, 2.0)).unwrap_err();
            assert_eq!(err.field, "transform_matrix");
        }
    }

    #[test]
    fn a_last_row_other_than_0_0_0_1_is_refused() {
        let cam = example();
        let read = |m: DMat4| Camera::from_opengl(&m, (64, 48), (cam.fx, cam.fy), (cam.cx, cam.cy));
        let good = cam.to_opengl();
        assert!(read(good).is_ok(), "the control");
        let transposed = read(good.transpose()).unwrap_err();
        assert_eq!(transposed.field, "transform_matrix");
        assert!(transposed.reason.contains("must be 0 0 0 1"), "{transposed}");
        assert!(transposed.reason.contains("looks transposed"), "{transposed}");
        let with_last_row = |row: [f64; 4]| {
            let mut rows = good.transpose();
            rows.w_axis = DVec4::from(row);
            rows.transpose()
        };
        for row in [[0.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1e-3, 1.0], [0.0; 4], [0.0, 0.0, 0.0, -1.0]] {
            let error = read(with_last_row(row)).unwrap_err();
            assert!(error.reason.contains("must be 0 0 0 1"), "{row:?}: {error}");
            assert!(!error.reason.contains("transposed"), "{row:?}: {error}");
        }
        assert!(read(with_last_row([0.0, 0.0, f64::NAN, 1.0])).is_err());
        assert_eq!(
            read(with_last_row([0.0, 1e-8, 0.0, 1.0 - 1e-8])),
            read(good),
            "rounding of 32-bit floats"
        );
    }

    #[test]
    fn look_at_along_the_up_direction_gives_a_valid_rotation() {
        let cam = Camera::look_at(DVec3::Z, DVec3::ZERO, DVec3::Z, 1.0, (8, 8)).unwrap();
        assert!((cam.rotation.determinant() - 1.0).abs() < 1e-12);
    }
}
