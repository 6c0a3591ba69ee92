//! The training photographs with their cameras, in the normalised world, at two resolutions, composited when they are
//! decoded.

mod cache;
mod gain;
mod stored_photo;

use std::sync::Arc;

use rayon::prelude::*;

use crate::light_groups::{self, RelativeLight};
use cache::PhotoCache;
use relume_capture::{Capture, CaptureView, MeasuredCard, MeasuredChart};
use relume_engine::{Photo, PhotoLight, PhotoLights, PhotoSize};
use relume_scene::{Camera, DisplayRange};
use relume_spec::training::TrainConfig;
use stored_photo::StoredPhoto;

pub use cache::DecodingStats;
pub use gain::Gain;
#[cfg(test)]
pub use gain::divide;

/// Background of masked photographs, as in relighting benchmarks.
pub const WHITE: [f32; 3] = [1.0; 3];

/// Least size of the cache of decoded photographs, bytes. The cache always has room for two photographs of the
/// largest size.
const CACHE_BYTES: usize = 512 << 20;

/// All training photographs.
#[derive(Debug)]
pub struct Dataset {
    photos: Vec<Arc<StoredPhoto>>,
    cache: PhotoCache,
    /// Capture to normalised world: `x' = scale * (x + offset)`.
    pub scale: f64,
    /// Offset of the transform in `scale`.
    pub offset: glam::DVec3,
    /// Background over which the photographs are composited.
    pub background: [f32; 3],
    /// Lights of the photographs.
    pub lights: PhotoLights,
    /// Names of the light groups.
    pub light_groups: Vec<String>,
    /// Light of each light group relative to the mean light; its photographs are divided by the level.
    pub relative_lights: Vec<RelativeLight>,
    /// The light group of the photograph that shows the grey card or the colour chart.
    pub reference_group: Option<usize>,
    /// True when the photographs have masks.
    pub has_alpha: bool,
    /// Names of the photographs.
    pub names: Vec<String>,
    /// Range of the photographs: `Extended` if one of them is scene-referred with values above 1.
    pub range: DisplayRange,
    /// The grey card in the photographs, in the capture's world.
    pub card: Option<MeasuredCard>,
    /// The colour chart whose matrix the photographs have, in the capture's world.
    pub chart: Option<MeasuredChart>,
}

impl Dataset {
    /// Prepares the training views as `config` specifies. Those that already have its resolution share their pixels
    /// with `capture`.
    pub fn new(capture: &Capture, config: &TrainConfig) -> Self {
        let scale = 1.0 / capture.bounds.radius.max(1e-12);
        let offset = -capture.bounds.centre;
        let has_alpha = capture.has_alpha;
        // Photographs without masks have no visible background.
        let background = if has_alpha { WHITE } else { [0.0; 3] };
        let degrees = |view: &CaptureView| if config.light_rotations { view.light_rotation_deg } else { 0.0 };
        let (light_groups, group_of) = light_groups::groups(&capture.train);
        let stated = group_of.into_iter().zip(capture.train.iter().map(degrees));
        let (lights, light_of) = PhotoLights::of(&stated.collect::<Vec<_>>());
        let range = capture.train.iter().map(|view| view.image.range()).max().unwrap_or_default();
        let photo = |(view, light): (&CaptureView, &PhotoLight)| {
            let sizes = [2, 1].map(|divisor| reduced_size(view, config.resolution, divisor));
            let camera =
                |(width, height)| view.camera.resized(width, height).in_normalised_world(scale, offset);
            let image = view.image.resized(sizes[1].0, sizes[1].1);
            let (cameras, light, mask, gains) = (sizes.map(camera), *light, None, Vec::new());
            Arc::new(StoredPhoto { image, cameras, light, mask, gains, background, has_alpha, range })
        };
        let photos: Vec<_> = capture.train.par_iter().zip(&light_of).map(photo).collect();
        let names = capture.train.iter().map(|view| view.name.clone()).collect();
        let cache = PhotoCache::new(cache_bytes(photos.iter().map(|p| p.decoded_bytes(PhotoSize::Full))));
        let (card, chart) = (capture.grey_card, capture.colour_chart.clone());
        let grey_card = config.grey_card.as_ref().map(|card| &card.photo);
        let shown_in = grey_card.or(config.colour_chart.as_ref().map(|chart| &chart.photo));
        let reference_group = shown_in.and_then(|photo| {
            let group = capture.light_group_of(photo).unwrap_or(light_groups::DEFAULT_GROUP);
            light_groups.iter().position(|name| name == group)
        });
        let mut data = Self {
            photos,
            cache,
            scale,
            offset,
            background,
            lights,
            light_groups,
            relative_lights: Vec::new(),
            reference_group,
            has_alpha,
            names,
            range,
            card,
            chart,
        };
        data.relative_lights = light_groups::relative_lights(&data);
        if data.relative_lights.len() > 1 {
            let level = |of: &PhotoLight| [data.relative_lights[of.light.group].level; 3];
            let levels: Vec<Gain> = light_of.iter().map(level).collect();
            data.divide(&levels);
        }
        data
    }

    /// Opaque photographs with the pixels of a test, at 16 bits.
    #[cfg(test)]
    pub fn of_photos(photos: &[Photo]) -> Self {
        use relume_scene::{BitDepth, ImageRgba, PackedImage};
        let stored = |Photo { camera, pixels, light, .. }: &Photo| {
            let pixels = pixels.iter().map(|&[r, g, b]| [r, g, b, 1.0]).collect();
            let image = ImageRgba { width: camera.width, height: camera.height, pixels };
            let image = PackedImage::new(&image, BitDepth::Sixteen);
            let half = camera.resized(camera.width.div_ceil(2), camera.height.div_ceil(2));
            let (mask, gains, background) = (None, Vec::new(), WHITE);
            let (cameras, light, has_alpha) = ([half, *camera], *light, false);
            let range = DisplayRange::Unit;
            Arc::new(StoredPhoto { image, cameras, light, mask, gains, background, has_alpha, range })
        };
        Self {
            photos: photos.iter().map(stored).collect(),
            cache: PhotoCache::new(CACHE_BYTES),
            scale: 1.0,
            offset: glam::DVec3::ZERO,
            background: WHITE,
            lights: PhotoLights::default(),
            light_groups: vec![light_groups::DEFAULT_GROUP.to_owned()],
            relative_lights: vec![RelativeLight::default()],
            reference_group: None,
            has_alpha: false,
            names: Vec::new(),
            range: DisplayRange::Unit,
            card: None,
            chart: None,
        }
    }

    /// Sets the bound of the cache of decoded photographs, bytes.
    pub fn bound(&mut self, bytes: usize) {
        self.cache = PhotoCache::new(bytes);
    }

    /// Number of photographs.
    pub fn len(&self) -> usize {
        self.photos.len()
    }

    /// Divides each photograph by its gain.
    pub fn divide(&mut self, gains: &[Gain]) {
        self.photos.iter_mut().zip(gains).for_each(|(photo, gain)| Arc::make_mut(photo).gains.push(*gain));
        self.cache.clear();
    }

    /// Restricts the photographs to a subject on white. `mask` returns the share of each pixel of a camera that the
    /// subject covers; `scale` and `offset` transform the cameras to the world of the subject.
    pub fn cut_out(&mut self, (scale, offset): (f64, glam::DVec3), mask: impl Fn(&Camera) -> Vec<f32>) {
        (self.has_alpha, self.background) = (true, WHITE);
        for photo in &mut self.photos {
            let levels = mask(photo.camera(PhotoSize::Full)).into_iter().map(|a| (a * 255.0).round() as u8);
            let photo = Arc::make_mut(photo);
            photo.mask = Some(levels.collect());
            photo.cameras = photo.cameras.map(|camera| camera.in_normalised_world(scale, offset));
            (photo.has_alpha, photo.background) = (true, WHITE);
        }
        self.cache.clear();
    }

    /// Photograph `index` at `size`, for a training step.
    pub fn photo(&self, index: usize, size: PhotoSize) -> Arc<Photo> {
        self.cache.get((index, size), &self.photos[index])
    }

    /// Photograph `index` at `size` without its pixels.
    pub fn without_pixels(&self, index: usize, size: PhotoSize) -> Photo {
        self.photos[index].without_pixels(size)
    }

    /// Starts to decode the photographs that the next steps need.
    pub fn prefetch(&self, next: impl Iterator<Item = (usize, PhotoSize)>) {
        self.cache.prefetch(next.map(|key| (key, self.photos[key.0].clone())));
    }

    /// Photograph `index` at `size`, for occasional use: it is not added to the cache.
    pub fn decode_uncached(&self, index: usize, size: PhotoSize) -> Arc<Photo> {
        self.cache.peek((index, size)).unwrap_or_else(|| Arc::new(self.photos[index].decoded(size)))
    }

    /// Calls `act` with all photographs at `size`, in order. As many as there are threads are decoded at a time.
    pub fn for_each_photo(&self, size: PhotoSize, mut act: impl FnMut(usize, &Photo)) {
        let at_once = rayon::current_num_threads().max(1);
        for first in (0..self.len()).step_by(at_once) {
            let indices = first..self.len().min(first + at_once);
            let photos: Vec<_> = indices.into_par_iter().map(|i| self.decode_uncached(i, size)).collect();
            photos.iter().enumerate().for_each(|(k, photo)| act(first + k, photo));
        }
    }

    /// Camera of photograph `index` at `size`, normalised world.
    pub fn camera(&self, index: usize, size: PhotoSize) -> &Camera {
        self.photos[index].camera(size)
    }

    /// All cameras at `size`, normalised world.
    pub fn cameras(&self, size: PhotoSize) -> Vec<&Camera> {
        self.photos.iter().map(|photo| photo.camera(size)).collect()
    }

    /// Camera centres, normalised world.
    pub fn camera_centres(&self) -> Vec<[f32; 3]> {
        let centre = |camera: &Camera| camera.centre().as_vec3().to_array();
        self.cameras(PhotoSize::Full).into_iter().map(centre).collect()
    }

    /// Pixels of the largest photograph.
    pub fn largest(&self) -> usize {
        self.photos.iter().map(|photo| photo.image.len()).max().unwrap_or(0)
    }

    /// Bytes of memory of the stored photographs, including pixels that a capture shares.
    pub fn bytes(&self) -> usize {
        self.photos.iter().map(|photo| photo.bytes()).sum()
    }

    /// Statistics of the decoding for training steps.
    pub fn decoding(&self) -> DecodingStats {
        self.cache.stats()
    }
}

/// Size of the cache for photographs that take `decoded` bytes each, bytes.
pub fn cache_bytes(decoded: impl Iterator<Item = usize>) -> usize {
    decoded.max().unwrap_or(0).saturating_mul(2).max(CACHE_BYTES)
}

/// Size of a view whose longest side is reduced to `resolution` over `divisor` pixels; never enlarged.
fn reduced_size(view: &CaptureView, resolution: u32, divisor: u32) -> (u32, u32) {
    let longest = view.image.width.max(view.image.height);
    let target = (resolution.min(longest) / divisor).max(1);
    let side = |s: u32| (u64::from(s) * u64::from(target)).div_ceil(u64::from(longest)).max(1) as u32;
    (side(view.image.width), side(view.image.height))
}

#[cfg(test)]
mod tests;
