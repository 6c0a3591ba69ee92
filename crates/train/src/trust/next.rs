//! The places from which further photographs would help a model most.

use glam::DVec3;
use rayon::prelude::*;

use crate::exposure::reduced_camera;
use relume_engine::{TrainState, evaluation};
use relume_scene::{Camera, Field, Model, PhotographedViews, direction_of};

/// Greatest number of cameras among which places are chosen.
pub const MAX_CANDIDATES: usize = 2000;
/// Longest side of the views that are compared, pixels.
const SIDE: u32 = 128;
/// Angle to the nearest photograph from which a place counts fully, degrees.
const FULL_ANGLE_DEG: f64 = 45.0;
/// Least blending weight of a Gaussian that counts as shown, pixels.
const MIN_WEIGHT: f32 = 0.02;
/// Share of its lack of confidence that a Gaussian loses when a chosen place shows it.
const GAINED: f32 = 0.5;

/// A place for a photograph.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NextPhotograph {
    /// Index of its camera among the candidates.
    pub candidate: usize,
    /// Mean of 1 - confidence over what the camera shows, given the places before it, 0 to 1.
    pub lack: f64,
    /// Angle to the nearest photograph or place before it, seen from the subject, degrees.
    pub nearest_deg: f64,
    /// Degrees counter-clockwise from the first photograph, seen from above, 0 to 360.
    pub azimuth_deg: f64,
    /// Degrees above the horizon, -90 to 90.
    pub elevation_deg: f64,
}

/// Why places cannot be compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NextPhotographError {
    /// The model has no confidence.
    #[error("the model has no confidence; only models that this version trained have it")]
    NoConfidence,
    /// The model card does not have the directions of the photographs.
    #[error("the model does not record a subject that its photographs surround")]
    NoSubject,
}

/// Up to `count` of the `candidates` (capture units), the most helpful first. Each maximises the lack of confidence of what it shows, times
/// its angle to the photographs and the places before it, where angles above 45 degrees count as 45.
///
/// # Errors
/// If the model has no confidence or no subject.
pub fn next_photographs(
    model: &Model,
    candidates: &[Camera],
    count: usize,
) -> Result<Vec<NextPhotograph>, NextPhotographError> {
    let confidence = model.gaussians.confidence().ok_or(NextPhotographError::NoConfidence)?;
    let photographed = PhotographedViews::of_card(&model.card).ok_or(NextPhotographError::NoSubject)?;
    let direction = |camera: &Camera| (camera.centre() - photographed.target).normalize_or_zero();
    let directions: Vec<DVec3> = candidates.iter().map(direction).collect();
    let mut taken: Vec<DVec3> =
        photographed.photographs.iter().map(|p| direction_of(p.azimuth_deg, p.elevation_deg)).collect();
    let views = Views::of(model, candidates);
    let mut lack: Vec<f32> = confidence.iter().map(|c| 1.0 - c).collect();
    let mut chosen: Vec<NextPhotograph> = Vec::new();
    while chosen.len() < count.min(candidates.len()) {
        let is_free = |index: &usize| chosen.iter().all(|next| next.candidate != *index);
        let places = (0..candidates.len()).filter(is_free).map(|index| NextPhotograph {
            candidate: index,
            lack: views.mean(index, &lack),
            nearest_deg: nearest_deg(&taken, directions[index]),
            azimuth_deg: azimuth_deg(directions[index], photographed.azimuth_deg),
            elevation_deg: directions[index].z.clamp(-1.0, 1.0).asin().to_degrees(),
        });
        let score = |next: &NextPhotograph| next.lack * next.nearest_deg.min(FULL_ANGLE_DEG);
        let Some(best) = places.reduce(|a, b| if score(&b) > score(&a) { b } else { a }) else { break };
        views.photograph(best.candidate, &mut lack);
        taken.push(directions[best.candidate]);
        chosen.push(best);
    }
    Ok(chosen)
}

/// Azimuth of a direction, degrees counter-clockwise from `from_deg`, 0 to 360.
fn azimuth_deg(direction: DVec3, from_deg: f64) -> f64 {
    (direction.y.atan2(direction.x).to_degrees() - from_deg).rem_euclid(360.0)
}

fn nearest_deg(taken: &[DVec3], direction: DVec3) -> f64 {
    if direction == DVec3::ZERO {
        return 0.0; // A camera in the middle of the subject.
    }
    // Exact for small angles, unlike the arc cosine.
    let angle = |other: &DVec3| other.cross(direction).length().atan2(other.dot(direction)).to_degrees();
    taken.iter().map(angle).fold(180.0, f64::min)
}

/// The Gaussians that each candidate shows, with their blending weight and the share of their footprint that other Gaussians do not hide.
struct Views {
    shown: Vec<Vec<(u32, f32, f32)>>,
}

impl Views {
    fn of(model: &Model, candidates: &[Camera]) -> Self {
        let mut model = model.clone();
        // Gaussians that no photograph shows are among the parts that the next ones should show.
        model.gaussians.field_mut(Field::SamplingRate).iter_mut().for_each(|rate| *rate = rate.abs());
        let (scale, offset) = (model.world_scale, model.world_offset);
        let state = TrainState::new(model);
        let of = |camera: &Camera| {
            let camera = reduced_camera(&camera.in_normalised_world(scale, offset), SIDE);
            let nothing = vec![0.0; camera.width as usize * camera.height as usize];
            let shown = (0..).zip(evaluation::shown_in(&state, &camera, &nothing));
            let shown = shown.filter_map(|(i, shown)| shown.map(|shown| (i, shown.weight, shown.share)));
            shown.filter(|(_, weight, _)| *weight > MIN_WEIGHT).collect()
        };
        Self { shown: candidates.par_iter().map(of).collect() }
    }

    /// Mean of `values` over what a candidate shows; 0 if it shows nothing.
    fn mean(&self, candidate: usize, values: &[f32]) -> f64 {
        let weighted = |(i, weight, _): &(u32, f32, f32)| f64::from(weight * values[*i as usize]);
        let weight: f64 = self.shown[candidate].iter().map(|(_, weight, _)| f64::from(*weight)).sum();
        let sum: f64 = self.shown[candidate].iter().map(weighted).sum();
        if weight > 0.0 { sum / weight } else { 0.0 }
    }

    /// Reduces the lack of confidence of what a candidate shows.
    fn photograph(&self, candidate: usize, lack: &mut [f32]) {
        self.shown[candidate].iter().for_each(|(i, _, share)| lack[*i as usize] *= 1.0 - GAINED * share);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_scene::Gaussians;
    use serde_json::json;

    /// Four opaque walls around the origin, of confidence 0.9 but for the one on the side of +y, photographed from +x.
    fn model(photographed_azimuths: &[f64]) -> Model {
        let mut g = Gaussians::zeroed(4, 1, 0, 0);
        for (i, [x, y]) in [[0.5, 0.0], [0.0, 0.5], [-0.5, 0.0], [0.0, -0.5f32]].into_iter().enumerate() {
            g.row_mut(Field::Mean, i).copy_from_slice(&[x, y, 0.0]);
            let flat = |v: f32| if v == 0.0 { 0.3f32.ln() } else { 0.02f32.ln() };
            g.row_mut(Field::LogScale, i).copy_from_slice(&[flat(x), flat(y), 0.3f32.ln()]);
            g.row_mut(Field::Quaternion, i)[0] = 1.0;
            g.row_mut(Field::OpacityLogit, i)[0] = 8.0;
        }
        g.set_confidence(vec![0.9, 0.2, 0.9, 0.9]);
        let mut model = Model::new(g, vec![[0.5; 3]], vec![[0.5; 3]; 8], (4, 2));
        let photograph = |a: &f64| json!({ "name": "p", "azimuth_deg": a, "elevation_deg": 0.0 });
        let photographs: Vec<_> = photographed_azimuths.iter().map(photograph).collect();
        model.card = json!({ "photographed_views": {
            "target": [0.0, 0.0, 0.0], "radius": 0.6, "distance": 4.0, "azimuth_deg": 0.0, "elevation_deg": 0.0,
            "fov_deg": 40.0, "photographs": photographs } });
        model
    }

    fn camera(azimuth_deg: f64) -> Camera {
        Camera::look_at(4.0 * direction_of(azimuth_deg, 0.0), DVec3::ZERO, DVec3::Z, 0.5, (64, 64)).unwrap()
    }

    #[test]
    fn least_confident_side_comes_first_and_no_place_twice() {
        let candidates = [0.0, 90.0, 180.0, 270.0].map(camera);
        let all = [0.0, 45.0, 135.0, 225.0, 315.0];
        let next = next_photographs(&model(&all), &candidates, 9).unwrap();
        let order: Vec<usize> = next.iter().map(|next| next.candidate).collect();
        assert_eq!((order[0], order.len()), (1, 4), "{next:?}");
        assert!(next[0].lack > 0.6 && next[1].lack < 0.3, "{next:?}");
        assert!((next[0].azimuth_deg - 90.0).abs() < 1e-9 && next[0].elevation_deg.abs() < 1e-9, "{next:?}");
        let mut even = model(&all);
        even.gaussians.set_confidence(vec![0.5; 4]);
        let first = next_photographs(&even, &candidates, 1).unwrap()[0];
        assert_ne!(first.candidate, 0, "a photograph is there already");
    }

    #[test]
    fn places_far_from_photographs_come_first() {
        let mut even = model(&[0.0, 20.0, 340.0]);
        even.gaussians.set_confidence(vec![0.5; 4]);
        let next = next_photographs(&even, &[10.0, 30.0, 180.0, 170.0].map(camera), 2).unwrap();
        assert!(next[0].candidate >= 2 && next[0].nearest_deg > 90.0, "{next:?}");
        assert!(next[1].candidate < 2, "the other candidate of the far side is beside the first: {next:?}");
    }

    #[test]
    fn model_without_confidence_or_subject_is_refused() {
        let mut without = model(&[0.0]);
        without.gaussians.set_confidence(Vec::new());
        let refused = |model: &Model| next_photographs(model, &[camera(0.0)], 1).unwrap_err();
        assert_eq!(refused(&without), NextPhotographError::NoConfidence);
        let mut aimless = model(&[0.0]);
        aimless.card = json!({});
        assert_eq!(refused(&aimless), NextPhotographError::NoSubject);
    }
}
