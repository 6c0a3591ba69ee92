//! Gaussians that no photograph shows: behind surfaces, below the ground, outside of all images. No photograph constrains them, so a
//! view from elsewhere would show colours and shapes without evidence. They stay in the model, because they close surfaces at the back
//! for measurements of visibility and for shadows; frames omit them (docs/decisions/0048-gaussians-without-a-photograph.md).

use glam::DVec3;
use rayon::prelude::*;

use crate::sampling_rate::is_in_image;
use relume_engine::{TrainState, evaluation};
use relume_scene::{Camera, Field};

/// Share of its footprint that at least one photograph must show so that frames show a Gaussian.
const SEEN_SHARE: f32 = 0.05;
/// Sampling rate of a hidden Gaussian during training; [`crate::sampling_rate::measure`] replaces its magnitude.
const HIDDEN: f32 = -1.0;

/// Marks the Gaussians that none of `cameras` (normalised world) shows: images of the model omit them from now on.
pub(crate) fn hide(state: &mut TrainState, cameras: &[&Camera]) {
    let unseen = unseen(state, cameras);
    let rates = state.model.gaussians.field_mut(Field::SamplingRate);
    rates.iter_mut().zip(unseen).filter(|(_, unseen)| *unseen).for_each(|(rate, _)| *rate = HIDDEN);
}

/// Whether none of `cameras` (normalised world) shows each Gaussian. A Gaussian that is too small for the pixels of a camera counts as
/// seen, because its visibility is unknown. All `false` without cameras.
fn unseen(state: &TrainState, cameras: &[&Camera]) -> Vec<bool> {
    let mut unseen = vec![!cameras.is_empty(); state.model.gaussians.len()];
    for camera in cameras {
        let shares = evaluation::visible_shares(state, camera);
        unseen.par_iter_mut().enumerate().filter(|(_, unseen)| **unseen).for_each(|(i, unseen)| {
            *unseen = !match shares[i] {
                Some(share) => share >= SEEN_SHARE,
                None => {
                    let mean = DVec3::from(state.model.gaussians.get::<3>(Field::Mean, i).map(f64::from));
                    is_in_image(camera, camera.rotation * mean + camera.translation)
                }
            };
        });
    }
    unseen
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

    #[test]
    fn a_gaussian_hidden_from_every_camera_is_unseen() {
        let (left, right) = (camera(-4.0), camera(4.0));
        // The second disc is far behind the first, seen from the left, and smaller.
        let hidden = state(&[(0.0, 0.5), (0.5, 0.05)]);
        assert_eq!(unseen(&hidden, &[&left]), [false, true]);
        assert_eq!(unseen(&hidden, &[&left, &right]), [false, false], "the control: another camera shows it");
        let mut marked = hidden;
        hide(&mut marked, &[&left]);
        assert_eq!(marked.model.gaussians.field(Field::SamplingRate), [0.0, HIDDEN]);
        let in_front = state(&[(0.5, 0.5), (0.0, 0.05)]);
        assert_eq!(unseen(&in_front, &[&left]), [false, false], "the control: it is in front");
    }

    #[test]
    fn a_gaussian_outside_of_every_image_is_unseen() {
        let mut beside = state(&[(0.0, 0.5), (0.0, 0.05)]);
        beside.model.gaussians.row_mut(Field::Mean, 1)[1] = 9.0;
        assert_eq!(unseen(&beside, &[&camera(-4.0)]), [false, true]);
    }

    #[test]
    fn tiny_and_huge_gaussians_count_as_seen() {
        let tiny = state(&[(0.0, 0.5), (-1.0, 1e-4)]);
        assert_eq!(evaluation::visible_shares(&tiny, &camera(-4.0))[1], None, "no pixel shows it");
        assert_eq!(unseen(&tiny, &[&camera(-4.0)]), [false, false]);
        let backdrop = state(&[(2.0, 30.0), (0.0, 0.3)]);
        assert_eq!(unseen(&backdrop, &[&camera(-4.0)]), [false, false]);
    }

    #[test]
    fn without_cameras_every_gaussian_counts_as_seen() {
        assert_eq!(unseen(&state(&[(0.0, 0.5)]), &[]), [false]);
    }
}
