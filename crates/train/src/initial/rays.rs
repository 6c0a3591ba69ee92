//! Initial Gaussians behind the pixels of the photographs.

use glam::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::dataset::Dataset;
use crate::initial::Seed;
use crate::initial::plane_sweep::PlaneSweep;
use relume_engine::PhotoSize;
use relume_scene::Camera;

/// Nearest and farthest initial Gaussian along a ray, relative to the distance from the camera to the object.
const RAY_DEPTHS: [f64; 2] = [0.4, 4.0];
/// Pixels that are tried for each seed.
const TRIED: usize = 4;
/// Greatest share of the seeds at depths that the photographs determine; the others are where they determine none.
const DETERMINED: f64 = 0.75;

/// A point, with the photograph and pixel whose colour it has.
struct Origin {
    point: DVec3,
    photo: usize,
    /// Position in the image, as a share of its width and height.
    at: [f64; 2],
}

/// `wanted` seeds: where a plane sweep finds the depths of pixels, and at random depths along the rays of others.
pub(super) fn seeds(data: &Dataset, wanted: usize, rng: &mut ChaCha8Rng) -> Vec<Seed> {
    let mut origins = swept(data, (wanted as f64 * DETERMINED) as usize, rng);
    origins.extend((origins.len()..wanted).map(|_| at_random_depth(data, rng)));
    coloured(data, &origins)
}

/// At most `wanted` points at the depths that a plane sweep finds.
fn swept(data: &Dataset, wanted: usize, rng: &mut ChaCha8Rng) -> Vec<Origin> {
    let sweep = PlaneSweep::new(data);
    let tried: Vec<(usize, u32, u32)> = (0..TRIED * wanted)
        .map(|_| {
            let photo = rng.random_range(0..data.len());
            let camera = sweep.camera(photo);
            (photo, rng.random_range(0..camera.width), rng.random_range(0..camera.height))
        })
        .collect();
    let origin = |&(photo, x, y): &(usize, u32, u32)| {
        let camera = sweep.camera(photo);
        let distance = camera.centre().length().max(1e-3);
        let point = sweep.point(photo, (x, y), RAY_DEPTHS.map(|d| d * distance))?;
        Some(Origin { point, photo, at: shares(camera, [x, y]) })
    };
    let found: Vec<Option<Origin>> = tried.par_iter().map(origin).collect();
    found.into_iter().flatten().take(wanted).collect()
}

/// A point behind a random pixel of a random photograph, at a log-uniform depth around the object's distance: throughout the cameras'
/// frusta and never close to a camera.
fn at_random_depth(data: &Dataset, rng: &mut ChaCha8Rng) -> Origin {
    let photo = rng.random_range(0..data.len());
    let camera = data.camera(photo, PhotoSize::Half);
    let (x, y) = (rng.random_range(0..camera.width), rng.random_range(0..camera.height));
    let [near, far] = RAY_DEPTHS;
    let depth = camera.centre().length().max(1e-3) * near * (far / near).powf(rng.random::<f64>());
    let point = camera.centre() + camera.ray(x, y) * depth;
    Origin { point, photo, at: shares(camera, [x, y]) }
}

/// The centre of pixel (`x`, `y`) in shares of the image's size.
fn shares(camera: &Camera, [x, y]: [u32; 2]) -> [f64; 2] {
    [(x, camera.width), (y, camera.height)].map(|(at, size)| (f64::from(at) + 0.5) / f64::from(size))
}

/// The points with the colours of their pixels.
fn coloured(data: &Dataset, origins: &[Origin]) -> Vec<Seed> {
    // For each photograph, its seeds.
    let mut of: Vec<Vec<usize>> = vec![Vec::new(); data.len()];
    origins.iter().enumerate().for_each(|(i, origin)| of[origin.photo].push(i));
    let mut seeds: Vec<Seed> = origins.iter().map(|o| (o.point.as_vec3().to_array(), [0.0; 3])).collect();
    data.for_each_photo(PhotoSize::Half, |photo, image| {
        of[photo].iter().for_each(|i| seeds[*i].1 = image.pixels[pixel(&image.camera, origins[*i].at)]);
    });
    seeds
}

/// Index of the pixel at a position in shares of the image's size.
fn pixel(camera: &Camera, [u, v]: [f64; 2]) -> usize {
    let at = |share: f64, size: u32| ((share * f64::from(size)) as usize).min(size as usize - 1);
    at(v, camera.height) * camera.width as usize + at(u, camera.width)
}
