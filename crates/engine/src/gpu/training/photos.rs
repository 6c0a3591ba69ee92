//! Photographs in device memory.

use std::collections::HashMap;

use rayon::prelude::*;

use crate::gpu::{DevicePhoto, Gpu, photo_pixel};
use crate::{DeviceError, Photo, PhotoId, PhotoSize};

/// Maximum device memory of photographs, bytes; photographs beyond it are uploaded at each step.
const PHOTO_BYTES: usize = 4 << 30;

/// Smallest number of pixels per thread when a photograph is packed.
const SPLIT: usize = 1 << 14;

/// One revision of a photograph.
#[derive(Debug)]
struct CachedPhoto {
    revision: usize,
    photo: DevicePhoto,
}

/// Cache of photographs in device memory, rgb and mask per pixel.
#[derive(Debug, Default)]
pub(super) struct DevicePhotoCache {
    /// Photographs by index and size.
    photos: HashMap<(usize, PhotoSize), CachedPhoto>,
    bytes: usize,
}

impl DevicePhotoCache {
    /// True when the photograph is in device memory.
    pub(super) fn holds(&self, id: PhotoId) -> bool {
        self.held(id).is_some()
    }

    fn held(&self, id: PhotoId) -> Option<&DevicePhoto> {
        let found = self.photos.get(&(id.index, id.size)).filter(|found| found.revision == id.revision);
        found.map(|found| &found.photo)
    }

    /// The photograph in device memory; it is cached while the memory for photographs suffices. The pixels of a cached
    /// photograph are not read.
    pub(super) fn upload(
        &mut self,
        gpu: &Gpu,
        id: PhotoId,
        photo: &Photo,
    ) -> Result<DevicePhoto, DeviceError> {
        if let Some(held) = self.held(id) {
            return Ok(held.clone());
        }
        let (width, height) = (photo.camera.width as usize, photo.camera.height as usize);
        if photo.pixels.len() != width * height {
            return Err(DeviceError::Misuse(format!("photograph {} without its pixels", id.index)));
        }
        let alpha = |i: usize| photo.alpha.get(i).copied().unwrap_or(1.0);
        let pixels = photo.pixels.par_iter().enumerate().with_min_len(SPLIT);
        let packed = |(i, [r, g, b]): (usize, &[f32; 3])| photo_pixel([*r, *g, *b, alpha(i)], photo.range);
        let pixels: Vec<_> = pixels.map(packed).collect();
        let uploaded = DevicePhoto { pixels: gpu.upload("a photograph", &pixels)?, range: photo.range };
        let bytes = size_of_val(&pixels[..]);
        let key = (id.index, id.size);
        // A photograph of another revision has the same size and is replaced.
        if self.photos.contains_key(&key) || self.bytes + bytes <= PHOTO_BYTES {
            let cached = CachedPhoto { revision: id.revision, photo: uploaded.clone() };
            let earlier = self.photos.insert(key, cached);
            self.bytes += if earlier.is_none() { bytes } else { 0 };
        }
        Ok(uploaded)
    }
}
