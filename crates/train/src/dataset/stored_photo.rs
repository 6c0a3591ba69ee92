//! A training photograph as it is stored in memory, and its decoding for a step.

use std::sync::Arc;

use crate::dataset::gain::{Gain, divide};
use relume_engine::{Photo, PhotoLight, PhotoSize};
use relume_scene::{Camera, DisplayRange, ImageRgba, PackedImage};

/// A photograph at the configured resolution: its integer pixels, and the operations that are applied when it is
/// decoded.
#[derive(Debug, Clone)]
pub struct StoredPhoto {
    /// The pixels.
    pub image: PackedImage,
    /// Cameras at half and at the full configured resolution, normalised world.
    pub cameras: [Camera; 2],
    /// Rotation of the light.
    pub light: PhotoLight,
    /// Mask of a cropped subject, levels of 1/255, row-major; it replaces the image's own alpha.
    pub mask: Option<Arc<[u8]>>,
    /// Gains by which the photograph is divided, in order.
    pub gains: Vec<Gain>,
    /// Background behind transparent pixels, display-referred.
    pub background: [f32; 3],
    /// Whether decoded photographs include alpha.
    pub has_alpha: bool,
    /// Range of all photographs of the capture.
    pub range: DisplayRange,
}

/// Bytes per pixel of a decoded photograph: three floats, and a fourth for a mask.
const DECODED_PIXEL: [usize; 2] = [12, 16];

impl StoredPhoto {
    /// The camera at `size`.
    pub fn camera(&self, size: PhotoSize) -> &Camera {
        match size {
            PhotoSize::Half => &self.cameras[0],
            PhotoSize::Full => &self.cameras[1],
        }
    }

    /// Bytes of memory of the stored photograph, including pixels that a capture shares.
    pub fn bytes(&self) -> usize {
        self.image.bytes() + self.mask.as_ref().map_or(0, |mask| mask.len())
    }

    /// Bytes of memory of the photograph decoded at `size`.
    pub fn decoded_bytes(&self, size: PhotoSize) -> usize {
        let camera = self.camera(size);
        camera.width as usize * camera.height as usize * DECODED_PIXEL[usize::from(self.has_alpha)]
    }

    /// The photograph at `size` without its pixels.
    pub fn without_pixels(&self, size: PhotoSize) -> Photo {
        let (camera, light, range) = (*self.camera(size), self.light, self.range);
        Photo { camera, pixels: Vec::new(), alpha: Vec::new(), light, range }
    }

    /// The decoded photograph at `size`, for a step.
    pub fn decoded(&self, size: PhotoSize) -> Photo {
        let camera = *self.camera(size);
        let stored = (self.image.width, self.image.height);
        let (pixels, alpha) = if (camera.width, camera.height) == stored {
            self.composited((0..self.image.len()).map(|i| self.pixel(i)))
        } else {
            let reduced = ImageRgba::reduced(stored, (camera.width, camera.height), |i| self.pixel(i));
            self.composited(reduced.pixels.into_iter())
        };
        let mut photo = Photo { pixels, alpha, ..self.without_pixels(size) };
        self.gains.iter().for_each(|gain| divide(&mut photo, *gain, self.background));
        photo
    }

    /// Pixel `i` of the image, straight alpha.
    #[inline]
    fn pixel(&self, i: usize) -> [f32; 4] {
        let [r, g, b, a] = self.image.pixel(i);
        let alpha = self.mask.as_ref().map_or(a, |mask| f32::from(mask[i]) / 255.0);
        [r, g, b, alpha]
    }

    /// Colours over the background, and the mask if there is one.
    fn composited(&self, pixels: impl ExactSizeIterator<Item = [f32; 4]>) -> (Vec<[f32; 3]>, Vec<f32>) {
        let mut alpha = Vec::with_capacity(if self.has_alpha { pixels.len() } else { 0 });
        let over = |p: [f32; 4]| {
            if self.has_alpha {
                alpha.push(p[3]);
            }
            std::array::from_fn(|k| p[k] * p[3] + self.background[k] * (1.0 - p[3]))
        };
        let colours = pixels.map(over).collect();
        (colours, alpha)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use relume_scene::BitDepth;

    /// 8 x 6 pixels of 8-bit levels, with transparency on the left half if `transparent`.
    fn image(transparent: bool) -> ImageRgba {
        let level = |n: u32| (n * 37 % 256) as f32 / 255.0;
        let alpha = |i: u32| if transparent && i % 8 < 4 { level(3 + i) } else { 1.0 };
        let pixel = |i: u32| [level(i), level(i + 5), level(2 * i), alpha(i)];
        ImageRgba { width: 8, height: 6, pixels: (0..48).map(pixel).collect() }
    }

    fn stored(image: &ImageRgba, has_alpha: bool, background: [f32; 3]) -> StoredPhoto {
        let camera = Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, 0.7, (8, 6)).unwrap();
        StoredPhoto {
            image: PackedImage::new(image, BitDepth::Eight),
            cameras: [camera.resized(4, 3), camera],
            light: PhotoLight::default(),
            mask: None,
            gains: Vec::new(),
            background,
            has_alpha,
            range: DisplayRange::Unit,
        }
    }

    #[test]
    fn decoded_photograph_equals_the_image_exactly() {
        for (transparent, background) in [(false, [0.0; 3]), (true, [1.0; 3])] {
            let image = image(transparent);
            let photo = stored(&image, transparent, background).decoded(PhotoSize::Full);
            assert_eq!(photo.pixels, image.over(background), "bit for bit");
            let alpha: Vec<f32> = image.pixels.iter().map(|p| p[3]).collect();
            assert_eq!(photo.alpha, if transparent { alpha } else { Vec::new() });
        }
        let other = stored(&image(true), true, [0.0; 3]).decoded(PhotoSize::Full);
        assert_ne!(other.pixels, image(true).over([1.0; 3]), "the control: another background");
    }

    #[test]
    fn half_size_photograph_is_the_mean_of_its_pixels() {
        let image = image(true);
        let stored = stored(&image, true, [1.0; 3]);
        let (half, exact) = (stored.decoded(PhotoSize::Half), image.resized(4, 3));
        assert_eq!((half.camera.width, half.pixels.len()), (4, 12));
        assert_eq!(half.pixels, exact.over([1.0; 3]));
        assert_eq!(half.alpha, exact.pixels.iter().map(|p| p[3]).collect::<Vec<_>>());
        assert_ne!(half.pixels[..], stored.decoded(PhotoSize::Full).pixels[..12], "the control");
        assert_eq!(stored.decoded_bytes(PhotoSize::Half), 12 * 16);
    }

    #[test]
    fn mask_replaces_alpha_before_gains_are_applied() {
        let opaque = image(false);
        let mut cut = stored(&opaque, true, [1.0; 3]);
        cut.mask = Some((0..48u8).map(|i| if i < 24 { 0 } else { 255 }).collect());
        cut.gains = vec![[2.0; 3]];
        let photo = cut.decoded(PhotoSize::Full);
        assert!(
            photo.pixels[..24].iter().flatten().all(|v| (v - 1.0).abs() < 1e-6),
            "background stays white"
        );
        assert!(photo.alpha[..24].iter().all(|a| *a == 0.0) && photo.alpha[24..].iter().all(|a| *a == 1.0));
        let mut expected = stored(&opaque, false, [0.0; 3]).decoded(PhotoSize::Full);
        assert_ne!(photo.pixels[24..], expected.pixels[24..], "the control: without the gain");
        divide(&mut expected, [2.0; 3], [0.0; 3]);
        assert_eq!(photo.pixels[24..], expected.pixels[24..]);
    }
}
