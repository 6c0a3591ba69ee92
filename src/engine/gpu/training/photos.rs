//! Photographs in device memory.

use std::collections::HashMap;

use crate::engine::DeviceError;
use crate::engine::gpu::{Buffer, Gpu};
use crate::engine::{Photo, PhotoId, PhotoSize};

/// Device memory that photographs may take, bytes; more of them are sent anew each step.
const PHOTO_BYTES: usize = 4 << 30;

/// Pixels of one revision of a photograph.
#[derive(Debug)]
struct CachedPhoto {
    revision: usize,
    pixels: Buffer<[f32; 4]>,
}

/// Photographs that stay in device memory, rgb and mask a pixel.
#[derive(Debug, Default)]
pub(super) struct PhotoCache {
    /// By index and size.
    photos: HashMap<(usize, PhotoSize), CachedPhoto>,
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
        let key = (id.index, id.size);
        match self.photos.get(&key) {
            Some(found) if found.revision == id.revision => return Ok(found.pixels.clone()),
            _ => (),
        }
        let alpha = |i: usize| photo.alpha.get(i).copied().unwrap_or(1.0);
        let pixels: Vec<[f32; 4]> =
            photo.pixels.iter().enumerate().map(|(i, [r, g, b])| [*r, *g, *b, alpha(i)]).collect();
        let buffer = gpu.upload("a photograph", &pixels)?;
        let bytes = size_of_val(&pixels[..]);
        // One of another revision has the same size and gives way.
        if self.photos.contains_key(&key) || self.bytes + bytes <= PHOTO_BYTES {
            let cached = CachedPhoto { revision: id.revision, pixels: buffer.clone() };
            let earlier = self.photos.insert(key, cached);
            self.bytes += if earlier.is_none() { bytes } else { 0 };
        }
        Ok(buffer)
    }
}
