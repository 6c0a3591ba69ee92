//! Photographs in device memory.

use std::collections::HashMap;

use crate::engine::DeviceError;
use crate::engine::gpu::{Buffer, Gpu};
use crate::engine::{Photo, PhotoId};

/// Device memory that photographs may take, bytes; more of them are sent anew each step.
const PHOTO_BYTES: usize = 4 << 30;

/// Photographs that stay in device memory, rgb and mask a pixel.
#[derive(Debug, Default)]
pub(super) struct PhotoCache {
    photos: HashMap<PhotoId, Buffer<[f32; 4]>>,
    bytes: usize,
}

impl PhotoCache {
    /// The photograph in device memory; it stays there while the memory for photographs lasts.
    pub(super) fn upload(
        &mut self,
        gpu: &Gpu,
        id: PhotoId,
        photo: &Photo,
    ) -> Result<Buffer<[f32; 4]>, DeviceError> {
        if let Some(found) = self.photos.get(&id) {
            return Ok(found.clone());
        }
        let alpha = |i: usize| photo.alpha.get(i).copied().unwrap_or(1.0);
        let pixels: Vec<[f32; 4]> =
            photo.pixels.iter().enumerate().map(|(i, [r, g, b])| [*r, *g, *b, alpha(i)]).collect();
        let buffer = gpu.upload("a photograph", &pixels)?;
        let bytes = size_of_val(&pixels[..]);
        if self.bytes + bytes <= PHOTO_BYTES {
            self.bytes += bytes;
            self.photos.insert(id, buffer.clone());
        }
        Ok(buffer)
    }
}
