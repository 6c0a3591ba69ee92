//! Depths of single pixels by a plane sweep: a patch of one photograph is compared with neighbouring photographs at a series of depths
//! (Collins 1996), by normalised cross-correlation, which does not depend on exposure.

use glam::DVec3;

use crate::dataset::Dataset;
use relume_engine::PhotoSize;
use relume_scene::light::luminance;
use relume_scene::{Camera, Plane};

/// Greatest width and height of the compared photographs, pixels.
const MAX_SIDE: u32 = 160;
/// Pixels from the centre of a patch to its edge.
const HALF_PATCH: i64 = 3;
/// Pixels of a patch.
const PATCH: usize = ((2 * HALF_PATCH + 1) * (2 * HALF_PATCH + 1)) as usize;
/// Depths of a sweep.
const DEPTHS: usize = 64;
/// Neighbours of a photograph.
const NEIGHBOURS: usize = 4;
/// Neighbours whose correlations count; the others may be occluded.
const COUNTED: usize = 2;
/// Least, best and greatest angle between the rays of two neighbours to the point that they look at, radians.
const ANGLES: [f64; 3] = [0.05, 0.2, 0.7];
/// Least standard deviation of the display luminance in a patch.
const MIN_CONTRAST: f32 = 0.02;
/// Least mean correlation at the depth of a pixel.
const MIN_CORRELATION: f32 = 0.8;
/// Least difference to the correlation at any other depth, more than [`PEAK`] planes away.
const MIN_DISTINCTION: f32 = 0.1;
/// Planes on both sides of the best one that belong to its peak.
const PEAK: usize = 3;

/// A reduced photograph.
struct View {
    camera: Camera,
    /// Display luminance, row-major.
    luminance: Vec<f32>,
}

/// The photographs of a capture, prepared for sweeps.
pub(super) struct PlaneSweep {
    views: Vec<View>,
    /// For each photograph, the photographs with which it is compared.
    neighbours: Vec<Vec<usize>>,
}

impl PlaneSweep {
    /// Reduces all photographs of `data` and chooses their neighbours.
    pub(super) fn new(data: &Dataset) -> Self {
        let mut views = Vec::with_capacity(data.len());
        data.for_each_photo(PhotoSize::Full, |_, photo| {
            let (width, height) = (photo.camera.width, photo.camera.height);
            let values = photo.pixels.iter().map(|p| [luminance(*p)]).collect();
            let (w, h) = reduced_size(width, height);
            let image = Plane { width, height, values }.resized(w, h);
            let luminance = image.values.into_iter().flatten().collect();
            views.push(View { camera: photo.camera.resized(w, h), luminance });
        });
        let neighbours = (0..views.len()).map(|i| neighbours(&views, i)).collect();
        Self { views, neighbours }
    }

    /// The camera of photograph `index` at the size of the sweep.
    pub(super) fn camera(&self, index: usize) -> &Camera {
        &self.views[index].camera
    }

    /// The point that pixel (`x`, `y`) of photograph `index` shows, normalised world, at a depth between `near` and `far` along the
    /// optical axis; `None` if the photographs do not determine it.
    pub(super) fn point(&self, index: usize, (x, y): (u32, u32), [near, far]: [f64; 2]) -> Option<DVec3> {
        let view = &self.views[index];
        let patch = Patch::new(view, (i64::from(x), i64::from(y)))?;
        let neighbours: Vec<Projected<'_>> =
            self.neighbours[index].iter().map(|j| patch.seen_by(view, &self.views[*j])).collect();
        // Evenly spaced in inverse depth, as the shift in the neighbours is.
        let depth_at = |k: f64| 1.0 / (1.0 / near + (1.0 / far - 1.0 / near) * k / (DEPTHS - 1) as f64);
        let scores: [f32; DEPTHS] = std::array::from_fn(|k| score(&patch, &neighbours, depth_at(k as f64)));
        let best = best_plane(&scores)?;
        Some(view.camera.centre() + patch.direction * depth_at(best))
    }
}

/// The greatest size with the aspect of `width` x `height` within [`MAX_SIDE`].
fn reduced_size(width: u32, height: u32) -> (u32, u32) {
    let factor = (f64::from(MAX_SIDE) / f64::from(width.max(height))).min(1.0);
    let size = |side: u32| ((f64::from(side) * factor).round() as u32).max(1);
    (size(width), size(height))
}

/// The photographs that see the point in front of photograph `i`, at the distance of the origin, from the most suitable angles.
fn neighbours(views: &[View], i: usize) -> Vec<usize> {
    let camera = &views[i].camera;
    let point = camera.centre() + camera.forward() * camera.centre().length();
    let [least, ideal, greatest] = ANGLES;
    let mut found: Vec<(f64, usize)> = Vec::new();
    for (j, other) in views.iter().enumerate().filter(|(j, _)| *j != i) {
        let angle = (camera.centre() - point).angle_between(other.camera.centre() - point);
        if (least..greatest).contains(&angle) && camera.forward().dot(other.camera.forward()) > 0.5 {
            found.push(((angle / ideal).ln().abs(), j));
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    found.into_iter().take(NEIGHBOURS).map(|(_, j)| j).collect()
}

/// The pixels around one pixel, standardised to mean 0 and length 1.
struct Patch {
    values: [f32; PATCH],
    /// World directions of the pixels, of length 1 along the optical axis.
    directions: [DVec3; PATCH],
    /// That of the pixel at the centre.
    direction: DVec3,
}

impl Patch {
    /// `None` at the edge of the image and where the patch has little contrast.
    fn new(view: &View, (x, y): (i64, i64)) -> Option<Self> {
        let (width, height) = (i64::from(view.camera.width), i64::from(view.camera.height));
        let inside = |at: i64, size: i64| (HALF_PATCH..size - HALF_PATCH).contains(&at);
        if !(inside(x, width) && inside(y, height)) {
            return None;
        }
        let side = 2 * HALF_PATCH + 1;
        let pixel = |k: usize| (x + k as i64 % side - HALF_PATCH, y + k as i64 / side - HALF_PATCH);
        let values = std::array::from_fn(|k| {
            let (x, y) = pixel(k);
            view.luminance[(y * width + x) as usize]
        });
        let values = standardised(values, MIN_CONTRAST)?;
        let forward = view.camera.forward();
        let direction = |x: i64, y: i64| {
            let ray = view.camera.ray(x as u32, y as u32);
            ray / ray.dot(forward)
        };
        let directions = std::array::from_fn(|k| {
            let (x, y) = pixel(k);
            direction(x, y)
        });
        Some(Self { values, directions, direction: direction(x, y) })
    }

    /// The lines on which the pixels lie, in the camera of `other`.
    fn seen_by<'a>(&self, from: &View, other: &'a View) -> Projected<'a> {
        let camera = &other.camera;
        Projected {
            view: other,
            origin: camera.rotation * from.camera.centre() + camera.translation,
            directions: self.directions.map(|d| camera.rotation * d),
        }
    }
}

/// The lines of a patch's pixels in the coordinates of another camera: `origin + depth directions[k]`.
struct Projected<'a> {
    view: &'a View,
    origin: DVec3,
    directions: [DVec3; PATCH],
}

impl Projected<'_> {
    /// Correlation of the photograph with `patch` at `depth`; `None` if a pixel is outside of the photograph.
    fn correlation(&self, patch: &Patch, depth: f64) -> Option<f32> {
        let mut values = [0.0; PATCH];
        for (value, direction) in values.iter_mut().zip(&self.directions) {
            *value = self.view.luminance_at(self.origin + *direction * depth)?;
        }
        // A flat patch correlates with nothing.
        let Some(values) = standardised(values, 0.25 * MIN_CONTRAST) else { return Some(0.0) };
        Some(values.iter().zip(&patch.values).map(|(a, b)| a * b).sum())
    }
}

impl View {
    /// The luminance at the image of a point in camera coordinates, bilinear; `None` outside.
    fn luminance_at(&self, p: DVec3) -> Option<f32> {
        let camera = &self.camera;
        if !(p.z > 0.0) {
            return None;
        }
        let x = camera.fx * p.x / p.z + camera.cx - 0.5;
        let y = camera.fy * p.y / p.z + camera.cy - 0.5;
        let (width, height) = (camera.width as usize, camera.height as usize);
        if !(x >= 0.0 && y >= 0.0 && x < (width as f64 - 1.0) && y < (height as f64 - 1.0)) {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let (u, v) = ((x - column as f64) as f32, (y - row as f64) as f32);
        let at = |x: usize, y: usize| self.luminance[y * width + x];
        let upper = at(column, row) * (1.0 - u) + at(column + 1, row) * u;
        let lower = at(column, row + 1) * (1.0 - u) + at(column + 1, row + 1) * u;
        Some(upper * (1.0 - v) + lower * v)
    }
}

/// The values moved to mean 0 and scaled to length 1; `None` if their standard deviation is below `least`.
fn standardised(values: [f32; PATCH], least: f32) -> Option<[f32; PATCH]> {
    let mean = values.iter().sum::<f32>() / PATCH as f32;
    let centred = values.map(|v| v - mean);
    let length = centred.iter().map(|v| v * v).sum::<f32>().sqrt();
    (length >= least * (PATCH as f32).sqrt() && length > 0.0).then(|| centred.map(|v| v / length))
}

/// Mean of the [`COUNTED`] greatest correlations at `depth`; -1 if fewer photographs contain the patch.
fn score(patch: &Patch, neighbours: &[Projected<'_>], depth: f64) -> f32 {
    let mut found: Vec<f32> = neighbours.iter().filter_map(|n| n.correlation(patch, depth)).collect();
    if found.len() < COUNTED {
        return -1.0;
    }
    found.sort_by(|a, b| b.total_cmp(a));
    found[..COUNTED].iter().sum::<f32>() / COUNTED as f32
}

/// The plane with the greatest score, between planes by a parabola; `None` if its score is too low or not distinct.
fn best_plane(scores: &[f32; DEPTHS]) -> Option<f64> {
    let best = (1..DEPTHS).fold(0, |best, k| if scores[k] > scores[best] { k } else { best });
    let elsewhere = scores.iter().enumerate().filter(|(k, _)| k.abs_diff(best) > PEAK);
    let second = elsewhere.map(|(_, score)| *score).fold(-1.0, f32::max);
    if !(scores[best] >= MIN_CORRELATION && scores[best] - second >= MIN_DISTINCTION) {
        return None;
    }
    if best == 0 || best == DEPTHS - 1 {
        return None;
    }
    let [before, at, after] = [best - 1, best, best + 1].map(|k| f64::from(scores[k]));
    let curvature = before - 2.0 * at + after;
    let offset = if curvature < 0.0 { (0.5 * (before - after) / curvature).clamp(-0.5, 0.5) } else { 0.0 };
    Some(best as f64 + offset)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::initial::tests::{painted_plane, wall};

    /// Distances of the found points to the wall, in distances from their cameras, and the number of pixels without a depth.
    fn errors(photos: &[relume_engine::Photo]) -> (Vec<f64>, usize) {
        let sweep = PlaneSweep::new(&Dataset::of_photos(photos));
        let (mut errors, mut missed) = (Vec::new(), 0);
        for index in 0..photos.len() {
            for (x, y) in (10..38).step_by(3).flat_map(|x| (10..38).step_by(3).map(move |y| (x, y))) {
                match sweep.point(index, (x, y), [0.8, 8.0]) {
                    Some(point) => errors.push(wall(point).abs() / 2.0),
                    None => missed += 1,
                }
            }
        }
        (errors, missed)
    }

    #[test]
    fn sweep_finds_a_painted_wall_and_nothing_on_a_blank_one() {
        let photos = painted_plane(48, 1.0);
        let (mut found, missed) = errors(&photos);
        // Pixels at the edges are in too few photographs.
        assert!(3 * found.len() > missed, "{} found, {missed} not", found.len());
        found.sort_by(f64::total_cmp);
        let (median, tail) = (found[found.len() / 2], found[found.len() * 95 / 100]);
        assert!(median < 0.02 && tail < 0.06, "{median} {tail}");

        assert!(errors(&painted_plane(48, 0.0)).0.is_empty(), "a blank wall determines no depth");
        // The control: photographs at the places of others.
        let mut confused = photos.clone();
        let pixels: Vec<_> = photos.iter().map(|p| p.pixels.clone()).collect();
        confused
            .iter_mut()
            .zip(pixels.iter().cycle().skip(3))
            .for_each(|(photo, p)| photo.pixels.clone_from(p));
        let close = |errors: &[f64]| errors.iter().filter(|e| **e < 0.02).count();
        let wrong = errors(&confused).0;
        assert!(4 * close(&wrong) < close(&found), "{} of {}", close(&wrong), close(&found));
    }

    #[test]
    fn a_flat_or_ambiguous_curve_has_no_best_plane() {
        let peak = |at: usize, height: f32| -> [f32; DEPTHS] {
            std::array::from_fn(|k| (height - 0.2 * k.abs_diff(at) as f32).max(0.1))
        };
        assert_eq!(best_plane(&peak(20, 0.95)), Some(20.0));
        assert_eq!(best_plane(&peak(20, 0.5)), None, "too low");
        assert_eq!(best_plane(&peak(0, 0.95)), None, "at the end of the range");
        let (a, b) = (peak(20, 0.95), peak(40, 0.93));
        assert_eq!(best_plane(&std::array::from_fn(|k| a[k].max(b[k]))), None, "two peaks");
        assert_eq!(best_plane(&[f32::NAN; DEPTHS]), None);
    }
}
