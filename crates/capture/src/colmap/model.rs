//! A COLMAP model in memory, and the checks that both encodings share. Errors name the file and the field at fault.

use std::collections::BTreeMap;

use glam::{DQuat, DVec3};

use crate::CaptureError;
use crate::formats::ply_points::Point;
use crate::lens::Lens;
use crate::text::fault_of_name;
use relume_scene::srgb;

/// A sparse model as stored: world-to-camera poses, OpenCV axes, COLMAP's own world.
#[derive(Debug)]
pub(super) struct SparseModel {
    /// Lenses by camera id.
    pub lenses: BTreeMap<u32, Lens>,
    /// Images in file order.
    pub images: Vec<PosedImage>,
    /// Points with linear colours.
    pub points: Vec<Point>,
}

/// One registered image.
#[derive(Debug, Clone)]
pub(super) struct PosedImage {
    /// Path below the image folder.
    pub name: String,
    /// Camera id.
    pub camera: u32,
    /// World-to-camera rotation, unit.
    pub rotation: DQuat,
    /// World-to-camera translation.
    pub translation: DVec3,
}

/// A checked pose from quaternion w x y z and translation, world-to-camera.
pub(super) fn posed(
    file: &str,
    name: String,
    camera: u32,
    q: [f64; 4],
    t: [f64; 3],
) -> Result<PosedImage, CaptureError> {
    if let Some(fault) = fault_of_name(&name) {
        return Err(CaptureError::at_field(file, format!("images[{name}].name"), fault));
    }
    let rotation = DQuat::from_xyzw(q[1], q[2], q[3], q[0]);
    let length = rotation.length();
    if !(length.is_finite() && length > 1e-6) {
        return Err(CaptureError::at_field(file, format!("images[{name}].qvec"), "is not a rotation"));
    }
    let translation = DVec3::from(t);
    if !translation.is_finite() {
        return Err(CaptureError::at_field(
            file,
            format!("images[{name}].tvec"),
            "has a value that is not finite",
        ));
    }
    Ok(PosedImage { name, camera, rotation: rotation.normalize(), translation })
}

/// A checked point; `colour` is sRGB.
pub(super) fn coloured(
    file: &str,
    index: usize,
    position: DVec3,
    colour: [u8; 3],
) -> Result<Point, CaptureError> {
    if !position.is_finite() {
        return Err(CaptureError::at_field(
            file,
            format!("points3D[{index}].xyz"),
            "has a value that is not finite",
        ));
    }
    Ok((position, colour.map(|c| srgb::decode(f32::from(c) / 255.0))))
}

/// Refuses more than `allowed` entries; `limit` is the field of [`crate::ImportLimits`].
pub(super) fn check_count(
    file: &str,
    limit: &'static str,
    count: usize,
    allowed: usize,
) -> Result<(), CaptureError> {
    if count <= allowed {
        return Ok(());
    }
    Err(CaptureError::over_limit(file, limit, format!("{count}, {allowed} allowed")))
}
