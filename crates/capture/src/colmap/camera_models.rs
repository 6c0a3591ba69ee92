//! COLMAP's camera models: names, numbers of parameters, and the lens of each.

use crate::CaptureError;
use crate::distortion::Distortion;
use crate::lens::Lens;

/// Name and number of parameters of COLMAP's camera models, by COLMAP's id (`sensor/models.h`).
pub(super) const CAMERA_MODELS: [(&str, usize); 18] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
];

/// A lens from a model's name, image size in pixels and parameters.
///
/// # Errors
/// Names the camera whose model is not supported, or whose parameters are not finite or of another number.
pub(super) fn lens(
    file: &str,
    id: u32,
    model: &str,
    size: (f64, f64),
    p: &[f64],
) -> Result<Lens, CaptureError> {
    let error = |reason: String| CaptureError::at_field(file, format!("cameras[{id}].params"), reason);
    let Some((_, count)) = CAMERA_MODELS.iter().find(|(name, _)| *name == model) else {
        return Err(unknown_model(file, id, model));
    };
    if p.len() != *count {
        return Err(error(format!("{model} has {count} parameters, not {}", p.len())));
    }
    if !p.iter().all(|v| v.is_finite()) {
        return Err(error("must be finite".to_owned()));
    }
    let (focal, centre, distortion) = parameters(model, p).ok_or_else(|| {
        let reason = format!("the camera model {model} is not supported; run `colmap image_undistorter`");
        CaptureError::at_field(file, format!("cameras[{id}].model"), reason)
    })?;
    Ok(Lens {
        size: Some(size),
        focal: focal.map(Some),
        angle: [None; 2],
        centre: centre.map(Some),
        distortion: distortion.simplified(),
    })
}

/// Focal lengths, principal point and distortion; `None` for models that are not supported.
fn parameters(model: &str, p: &[f64]) -> Option<([f64; 2], [f64; 2], Distortion)> {
    let radial = |k1, k2| Distortion::RadialTangential { k: [k1, k2, 0.0, 0.0], p: [0.0; 2] };
    let fisheye = |k1, k2| Distortion::Fisheye { k: [k1, k2, 0.0, 0.0] };
    Some(match (model, p) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => ([f, f], [cx, cy], Distortion::None),
        ("PINHOLE", &[fx, fy, cx, cy]) => ([fx, fy], [cx, cy], Distortion::None),
        ("SIMPLE_RADIAL", &[f, cx, cy, k]) => ([f, f], [cx, cy], radial(k, 0.0)),
        ("RADIAL", &[f, cx, cy, k1, k2]) => ([f, f], [cx, cy], radial(k1, k2)),
        ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
            ([fx, fy], [cx, cy], Distortion::RadialTangential { k: [k1, k2, 0.0, 0.0], p: [p1, p2] })
        }
        ("OPENCV_FISHEYE", &[fx, fy, cx, cy, k1, k2, k3, k4]) => {
            ([fx, fy], [cx, cy], Distortion::Fisheye { k: [k1, k2, k3, k4] })
        }
        ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
            ([fx, fy], [cx, cy], Distortion::Rational { k: [k1, k2, k3, k4, k5, k6], p: [p1, p2] })
        }
        ("FOV", &[fx, fy, cx, cy, omega]) => ([fx, fy], [cx, cy], Distortion::FieldOfView { omega }),
        ("SIMPLE_FISHEYE", &[f, cx, cy]) => ([f, f], [cx, cy], fisheye(0.0, 0.0)),
        ("FISHEYE", &[fx, fy, cx, cy]) => ([fx, fy], [cx, cy], fisheye(0.0, 0.0)),
        ("SIMPLE_RADIAL_FISHEYE", &[f, cx, cy, k]) => ([f, f], [cx, cy], fisheye(k, 0.0)),
        ("RADIAL_FISHEYE", &[f, cx, cy, k1, k2]) => ([f, f], [cx, cy], fisheye(k1, k2)),
        ("THIN_PRISM_FISHEYE", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx, sy]) => {
            let lens = Distortion::ThinPrismFisheye { k: [k1, k2, k3, k4], p: [p1, p2], s: [sx, sy] };
            ([fx, fy], [cx, cy], lens)
        }
        ("RAD_TAN_THIN_PRISM_FISHEYE", &[fx, fy, cx, cy, k0, k1, k2, k3, k4, k5, p0, p1, s0, s1, s2, s3]) => {
            let (k, p, s) = ([k0, k1, k2, k3, k4, k5], [p0, p1], [s0, s1, s2, s3]);
            ([fx, fy], [cx, cy], Distortion::RadTanThinPrismFisheye { k, p, s })
        }
        _ => return None,
    })
}

/// The error for a model that COLMAP's list does not have.
pub(super) fn unknown_model(file: &str, id: u32, model: &str) -> CaptureError {
    let known = CAMERA_MODELS.map(|(name, _)| name).join(", ");
    let reason = format!("the camera model {model} is unknown; COLMAP's models are {known}");
    CaptureError::at_field(file, format!("cameras[{id}].model"), reason)
}
