//! The training photographs with their cameras: in the normalised world, at two resolutions, composited.

use rayon::prelude::*;

use crate::capture::{Capture, CaptureView};
use crate::engine::{LightTurn, LightTurns, Photo, PhotoSize};
use crate::train::TrainConfig;
use crate::train::exposure::{Gain, divide};

/// Background of masked photographs: what relighting benchmarks composite over.
pub const WHITE: [f32; 3] = [1.0; 3];

/// All training photographs.
#[derive(Debug, Clone)]
pub struct Dataset {
    /// At the configured resolution.
    pub full: Vec<Photo>,
    /// At half of it.
    pub half: Vec<Photo>,
    /// Capture to normalised world: `x' = scale * (x + offset)`.
    pub scale: f64,
    /// See `scale`.
    pub offset: glam::DVec3,
    /// Background the photographs were composited over.
    pub background: [f32; 3],
    /// Turns of the photographs' light.
    pub turns: LightTurns,
    /// True when the photographs have masks.
    pub has_alpha: bool,
    /// Names of the photographs.
    pub names: Vec<String>,
}

impl Dataset {
    /// Prepares the training views as `config` asks for them.
    pub fn new(capture: &Capture, config: &TrainConfig) -> Self {
        let scale = 1.0 / capture.bounds.radius.max(1e-12);
        let offset = -capture.bounds.centre;
        // Without a mask nothing shows through.
        let background = if capture.has_alpha { WHITE } else { [0.0; 3] };
        let degrees = |view: &CaptureView| if config.light_rotations { view.light_rotation_deg } else { 0.0 };
        let (turns, lights) = LightTurns::of(&capture.train.iter().map(degrees).collect::<Vec<_>>());
        let photo = |(view, light): (&CaptureView, &LightTurn), divisor: u32| {
            let longest = view.image.width.max(view.image.height);
            let target = (config.resolution.min(longest) / divisor).max(1);
            let side = |s: u32| (u64::from(s) * u64::from(target)).div_ceil(u64::from(longest)).max(1) as u32;
            let image = view.image.resized(side(view.image.width), side(view.image.height));
            let camera = view.camera.resized(image.width, image.height).in_normalised_world(scale, offset);
            let alpha =
                if capture.has_alpha { image.pixels.iter().map(|p| p[3]).collect() } else { Vec::new() };
            Photo { camera, pixels: image.over(background), alpha, light: *light }
        };
        let views = || capture.train.par_iter().zip(&lights);
        let all = |divisor: u32| views().map(|view| photo(view, divisor)).collect();
        let (full, half, has_alpha) = (all(1), all(2), capture.has_alpha);
        let names = capture.train.iter().map(|view| view.name.clone()).collect();
        Self { full, half, scale, offset, background, turns, has_alpha, names }
    }

    /// Divides each photograph by its gain.
    pub fn divide(&mut self, gains: &[Gain]) {
        for photos in [&mut self.full, &mut self.half] {
            photos.par_iter_mut().zip(gains).for_each(|(photo, gain)| divide(photo, *gain, self.background));
        }
    }

    /// Photograph `index` at `size`.
    pub fn photo(&self, index: usize, size: PhotoSize) -> &Photo {
        match size {
            PhotoSize::Half => &self.half[index],
            PhotoSize::Full => &self.full[index],
        }
    }

    /// Camera centres, normalised world.
    pub fn camera_centres(&self) -> Vec<[f32; 3]> {
        self.full.iter().map(|p| p.camera.centre().as_vec3().to_array()).collect()
    }
}
