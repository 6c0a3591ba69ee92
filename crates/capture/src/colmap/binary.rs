//! COLMAP's binary files. Every count is checked against the bytes that remain before memory is allocated. Errors
//! name the file and the entry at fault.

use std::collections::BTreeMap;

use glam::DVec3;

use super::camera_models::{CAMERA_MODELS, lens, unknown_model};
use super::model::{PosedImage, check_count, coloured, posed};
use crate::CaptureError;
use crate::formats::ply_points::Point;
use crate::lens::Lens;

/// A little-endian reader with bounds checks.
pub(super) struct ByteReader<'a> {
    file: &'a str,
    rest: &'a [u8],
    length: usize,
}

impl<'a> ByteReader<'a> {
    pub(super) fn new(file: &'a str, bytes: &'a [u8]) -> Self {
        Self { file, rest: bytes, length: bytes.len() }
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], CaptureError> {
        let (head, rest) = self.rest.split_first_chunk::<N>().ok_or_else(|| self.cut_short())?;
        self.rest = rest;
        Ok(*head)
    }

    fn cut_short(&self) -> CaptureError {
        let reason = format!("is truncated at byte {} of {}", self.length - self.rest.len(), self.length);
        CaptureError::File { file: self.file.to_owned(), reason }
    }

    fn u32(&mut self) -> Result<u32, CaptureError> {
        self.array().map(u32::from_le_bytes)
    }

    fn floats<const N: usize>(&mut self) -> Result<[f64; N], CaptureError> {
        let mut out = [0.0; N];
        for value in &mut out {
            *value = f64::from_le_bytes(self.array()?);
        }
        Ok(out)
    }

    /// A number of entries of at least `size` bytes each, checked against the bytes that remain.
    fn count(&mut self, size: usize) -> Result<usize, CaptureError> {
        let count = u64::from_le_bytes(self.array()?);
        let fits =
            usize::try_from(count).ok().filter(|n| n.checked_mul(size).is_some_and(|b| b <= self.rest.len()));
        fits.ok_or_else(|| CaptureError::File {
            file: self.file.to_owned(),
            reason: format!("declares {count} entries, more than its {} bytes can contain", self.length),
        })
    }

    fn skip(&mut self, bytes: usize) -> Result<(), CaptureError> {
        self.rest = self.rest.get(bytes..).ok_or_else(|| self.cut_short())?;
        Ok(())
    }

    /// A NUL-terminated path inside the capture.
    fn name(&mut self) -> Result<String, CaptureError> {
        const LONGEST: usize = 1024;
        let end = self.rest.iter().take(LONGEST).position(|&b| b == 0).ok_or_else(|| self.cut_short())?;
        let name = String::from_utf8_lossy(&self.rest[..end]).into_owned();
        self.rest = &self.rest[end + 1..];
        Ok(name)
    }
}

/// Lenses by camera id.
pub(super) fn cameras(mut bytes: ByteReader<'_>) -> Result<BTreeMap<u32, Lens>, CaptureError> {
    let mut lenses = BTreeMap::new();
    for _ in 0..bytes.count(48)? {
        let (id, model) = (bytes.u32()?, bytes.u32()?);
        let size = [u64::from_le_bytes(bytes.array()?), u64::from_le_bytes(bytes.array()?)];
        let Some((name, count)) = CAMERA_MODELS.get(model as usize) else {
            // The length of its parameters is unknown, so the entries after it cannot be found.
            return Err(unknown_model(bytes.file, id, &format!("number {model}")));
        };
        let mut params = Vec::with_capacity(*count);
        for _ in 0..*count {
            params.extend(bytes.floats::<1>()?);
        }
        lenses.insert(id, lens(bytes.file, id, name, (size[0] as f64, size[1] as f64), &params)?);
    }
    Ok(lenses)
}

/// Images in file order, at most `allowed`.
pub(super) fn images(mut bytes: ByteReader<'_>, allowed: usize) -> Result<Vec<PosedImage>, CaptureError> {
    let count = bytes.count(73)?;
    check_count(bytes.file, "max_images", count, allowed)?;
    let mut images = Vec::with_capacity(count);
    for _ in 0..count {
        let _id = bytes.u32()?;
        let (q, t) = (bytes.floats()?, bytes.floats()?);
        let camera = bytes.u32()?;
        let name = bytes.name()?;
        let observations = bytes.count(24)?;
        bytes.skip(observations * 24)?;
        images.push(posed(bytes.file, name, camera, q, t)?);
    }
    Ok(images)
}

/// Points in file order, at most `allowed`.
pub(super) fn points(mut bytes: ByteReader<'_>, allowed: usize) -> Result<Vec<Point>, CaptureError> {
    let count = bytes.count(51)?;
    check_count(bytes.file, "max_points", count, allowed)?;
    let mut points = Vec::with_capacity(count);
    for index in 0..count {
        bytes.skip(8)?;
        let position = DVec3::from(bytes.floats()?);
        let colour = bytes.array()?;
        bytes.skip(8)?;
        let track = bytes.count(8)?;
        bytes.skip(track * 8)?;
        points.push(coloured(bytes.file, index, position, colour)?);
    }
    Ok(points)
}
