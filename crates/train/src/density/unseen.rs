//! Gaussians that no photograph shows: behind surfaces, below the ground, outside of all images. No photograph constrains them, so a
//! view from elsewhere would show colours and shapes without evidence.

use glam::DVec3;
use rayon::prelude::*;

use crate::sampling_rate::is_in_image;
use relume_engine::{DensityPlan, PlannedGaussian, SplitOrigin, TrainState, evaluation};
use relume_scene::{Camera, Field};

/// Share of its footprint that one photograph must show so that a Gaussian is kept.
const SEEN_SHARE: f32 = 0.05;

/// The plan that keeps the Gaussians that at least one of `cameras` (normalised world) shows; `None` if that is all of them, or
/// none.
pub fn without_unseen(state: &TrainState, cameras: &[&Camera]) -> Option<DensityPlan> {
    let seen = seen(state, cameras);
    let keep = |(i, _): (usize, &bool)| PlannedGaussian { source: i as u32, origin: SplitOrigin::Keep };
    let gaussians: Vec<PlannedGaussian> =
        seen.iter().enumerate().filter(|(_, seen)| **seen).map(keep).collect();
    (!gaussians.is_empty() && gaussians.len() < seen.len()).then_some(DensityPlan { gaussians })
}

/// Whether at least one of `cameras` shows each Gaussian. A Gaussian that is too small for the pixels of a camera counts as seen,
/// because its visibility is unknown.
fn seen(state: &TrainState, cameras: &[&Camera]) -> Vec<bool> {
    let mut seen = vec![false; state.model.gaussians.len()];
    for camera in cameras {
        let shares = evaluation::visible_shares(state, camera);
        seen.par_iter_mut().enumerate().filter(|(_, seen)| !**seen).for_each(|(i, seen)| {
            *seen = match shares[i] {
                Some(share) => share >= SEEN_SHARE,
                None => {
                    let mean = DVec3::from(state.model.gaussians.get::<3>(Field::Mean, i).map(f64::from));
                    is_in_image(camera, camera.rotation * mean + camera.translation)
                }
            };
        });
    }
    seen
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_scene::{Gaussians, Model};

    const SIZE: u32 = 64;

    /// Flat Gaussians across the x axis at these x, of these standard deviations, almost opaque.
    fn state(discs: &[(f32, f32)]) -> TrainState {
        let mut g = Gaussians::zeroed(discs.len(), 1, 0, 0);
        for (i, (x, sigma)) in discs.iter().enumerate() {
            g.row_mut(Field::Mean, i)[0] = *x;
            g.row_mut(Field::LogScale, i).copy_from_slice(&[(0.01 * sigma).ln(), sigma.ln(), sigma.ln()]);
            g.row_mut(Field::Quaternion, i)[0] = 1.0;
            g.row_mut(Field::OpacityLogit, i)[0] = 9.0;
        }
        TrainState::new(Model::new(g, vec![[0.5; 3]], vec![[0.5; 3]; 8], (4, 2)))
    }

    fn camera(x: f64) -> Camera {
        Camera::look_at(DVec3::X * x, DVec3::ZERO, DVec3::Z, 0.8, (SIZE, SIZE)).unwrap()
    }

    fn kept(state: &TrainState, cameras: &[&Camera]) -> Option<Vec<u32>> {
        let plan = without_unseen(state, cameras)?;
        assert!(plan.gaussians.iter().all(|g| g.origin == SplitOrigin::Keep));
        Some(plan.gaussians.iter().map(|g| g.source).collect())
    }

    #[test]
    fn a_gaussian_hidden_from_every_camera_is_dropped() {
        let (left, right) = (camera(-4.0), camera(4.0));
        // The second disc is far behind the first, seen from the left, and smaller.
        let hidden = state(&[(0.0, 0.5), (0.5, 0.05)]);
        assert_eq!(kept(&hidden, &[&left]), Some(vec![0]));
        assert_eq!(kept(&hidden, &[&left, &right]), None, "the control: another camera shows it");
        assert_eq!(kept(&state(&[(0.5, 0.5), (0.0, 0.05)]), &[&left]), None, "the control: it is in front");
    }

    #[test]
    fn a_gaussian_outside_of_every_image_is_dropped() {
        let mut beside = state(&[(0.0, 0.5), (0.0, 0.05)]);
        beside.model.gaussians.row_mut(Field::Mean, 1)[1] = 9.0;
        assert_eq!(kept(&beside, &[&camera(-4.0)]), Some(vec![0]));
    }

    #[test]
    fn a_gaussian_smaller_than_the_pixels_is_kept() {
        let tiny = state(&[(0.0, 0.5), (-1.0, 1e-4)]);
        let shares = evaluation::visible_shares(&tiny, &camera(-4.0));
        assert_eq!(shares[1], None, "no pixel shows it");
        assert_eq!(kept(&tiny, &[&camera(-4.0)]), None);
    }

    #[test]
    fn a_gaussian_wider_than_the_image_is_kept() {
        let backdrop = state(&[(2.0, 30.0), (0.0, 0.3)]);
        assert_eq!(kept(&backdrop, &[&camera(-4.0)]), None);
    }

    #[test]
    fn a_state_that_no_camera_shows_is_left_unchanged() {
        assert_eq!(kept(&state(&[(0.0, 0.5)]), &[]), None);
    }
}
