//! Reads the lights that the header of a light matrix states.

use std::io::Read;

use exr::meta::header::Header;
use exr::prelude::{AttributeValue, MetaData};

use crate::formats::ImageFileError;
use crate::formats::exr_frame::text;
use crate::formats::exr_matrix::{ALPHA, DIRECTION, MatrixLightPart, RADIUS, SOLID_ANGLE};
use relume_scene::SplitLight;

/// What the header of a light matrix states.
#[derive(Debug, Clone, PartialEq)]
pub struct MatrixHeader {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// The lights, in the order of their parts.
    pub lights: Vec<MatrixLightPart>,
    /// Name of the part of each light.
    pub names: Vec<String>,
}

/// Reads the header of a file, and no pixels.
///
/// # Errors
/// [`ImageFileError::Damaged`] if it is not an OpenEXR file, [`ImageFileError::Unsupported`] if it is not a light matrix.
pub fn read_header(file: impl Read) -> Result<MatrixHeader, ImageFileError> {
    let meta =
        MetaData::read_from_buffered(file, false).map_err(|e| ImageFileError::Damaged(e.to_string()))?;
    let refused = |why: String| ImageFileError::Unsupported(why);
    let (mut lights, mut names) = (Vec::new(), Vec::new());
    for header in &meta.headers {
        let name = header.own_attributes.layer_name.as_ref().map(ToString::to_string).unwrap_or_default();
        if name == ALPHA {
            continue;
        }
        let light = light(header).ok_or_else(|| {
            refused(format!(
                "is not a light matrix: part {name:?} has no {DIRECTION}; render one with `relume render --light-matrix`"
            ))
        })?;
        // Names become part of scripts.
        if name.is_empty() || !name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_') {
            return Err(refused(format!(
                "part {name:?}: the name has other characters than letters, digits and _; use the file that Relume wrote"
            )));
        }
        lights.push(light);
        names.push(name);
    }
    let Some(first) = meta.headers.first().filter(|_| !lights.is_empty()) else {
        return Err(refused("is not a light matrix: it has no part for a light".to_owned()));
    };
    let side = |side: usize| u32::try_from(side).unwrap_or(u32::MAX);
    Ok(MatrixHeader { width: side(first.layer_size.0), height: side(first.layer_size.1), lights, names })
}

fn light(header: &Header) -> Option<MatrixLightPart> {
    let value = |name: &str| header.own_attributes.other.get(&text(name).ok()?);
    let number = |name: &str| match value(name) {
        Some(AttributeValue::F32(number)) if number.is_finite() => Some(*number),
        _ => None,
    };
    let Some(AttributeValue::FloatVec3((x, y, z))) = value(DIRECTION) else { return None };
    let direction = [*x, *y, *z];
    let length = direction.iter().map(|v| v * v).sum::<f32>();
    if !((length - 1.0).abs() < 1e-3) {
        return None;
    }
    match (number(SOLID_ANGLE), number(RADIUS)) {
        (Some(solid_angle), _) => Some(MatrixLightPart::Lobe { direction, solid_angle }),
        (None, Some(degrees)) => {
            Some(MatrixLightPart::Sun(SplitLight { direction, radius: degrees.to_radians() }))
        }
        _ => None,
    }
}
