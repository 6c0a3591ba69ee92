//! Differences between estimated poses and reference poses of the same photographs.

use glam::{DQuat, DVec3};

use relume_scene::Camera;

/// Greatest difference of two orientations that agree, degrees. The photographs that agree determine the alignment of
/// the worlds.
const AGREE_DEG: f64 = 5.0;

/// Errors after the worlds are aligned by a rotation, a scale and a translation, determined from the photographs that
/// agree.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseErrors {
    /// Angle between the orientations of each photograph, degrees.
    pub rotations_deg: Vec<f64>,
    /// Distance between the centres of each photograph, divided by the median distance of the reference cameras from
    /// their mean, both over the photographs that agree.
    pub positions: Vec<f64>,
}

impl PoseErrors {
    /// Compares estimated and reference poses of the same photographs, in the same order. `None` for fewer than
    /// three, and if all cameras have the same position.
    pub fn of(found: &[Camera], truth: &[Camera]) -> Option<Self> {
        let count = found.len().min(truth.len());
        if count < 3 {
            return None;
        }
        let (found, truth) = (&found[..count], &truth[..count]);
        let turn_of = |(found, truth): (&Camera, &Camera)| {
            DQuat::from_mat3(&(truth.rotation.transpose() * found.rotation)).normalize()
        };
        let turns: Vec<DQuat> = found.iter().zip(truth).map(turn_of).collect();
        let agreed = agreed(&turns)?;
        let agrees = |i: usize| turns[i].angle_between(agreed).to_degrees() < AGREE_DEG;
        let turn = mean(agreed, (0..count).filter(|i| agrees(*i)).map(|i| turns[i]));
        let middle = |cameras: &[Camera]| {
            let inside = || (0..count).filter(|i| agrees(*i)).map(|i| cameras[i].centre());
            inside().sum::<DVec3>() / inside().count() as f64
        };
        let (middle_here, middle_there) = (middle(found), middle(truth));
        let pair = |i: usize| (turn * (found[i].centre() - middle_here), truth[i].centre() - middle_there);
        let pairs = || (0..count).filter(|i| agrees(*i)).map(pair);
        let spread: f64 = pairs().map(|(a, _)| a.length_squared()).sum();
        let scale = pairs().map(|(a, b)| a.dot(b)).sum::<f64>() / spread;
        let unit = median(pairs().map(|(_, b)| b.length()).collect());
        let is_sound = scale.is_finite() && unit > 0.0;
        is_sound.then(|| Self {
            rotations_deg: turns.iter().map(|t| turn.angle_between(*t).to_degrees()).collect(),
            positions: (0..count).map(pair).map(|(a, b)| (a * scale - b).length() / unit).collect(),
        })
    }

    /// Number of orientations that agree within 5 degrees.
    pub fn agreeing(&self) -> usize {
        self.rotations_deg.iter().filter(|angle| **angle < AGREE_DEG).count()
    }

    /// Medians of the rotation errors, degrees, and of the position errors.
    pub fn medians(&self) -> (f64, f64) {
        (median(self.rotations_deg.clone()), median(self.positions.clone()))
    }

    /// The largest rotation error, degrees, and the largest position error.
    pub fn largest(&self) -> (f64, f64) {
        let largest = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
        (largest(&self.rotations_deg), largest(&self.positions))
    }
}

/// The rotation with the least median difference from the others: that of most photographs, whatever the errors of
/// the rest.
fn agreed(turns: &[DQuat]) -> Option<DQuat> {
    let off = |turn: &DQuat| median(turns.iter().map(|other| turn.angle_between(*other)).collect());
    turns.iter().copied().min_by(|a, b| off(a).total_cmp(&off(b)))
}

/// The mean of rotations that are close to `near`.
fn mean(near: DQuat, turns: impl Iterator<Item = DQuat>) -> DQuat {
    let zero = DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0);
    turns.fold(zero, |sum, turn| sum + if near.dot(turn) < 0.0 { -turn } else { turn }).normalize()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    fn cameras() -> Vec<Camera> {
        let eye =
            |i: u32| DVec3::new(3.0 * f64::from(i).cos(), 3.0 * f64::from(i).sin(), 1.0 + 0.1 * f64::from(i));
        (0..8).map(|i| Camera::look_at(eye(i), DVec3::ZERO, DVec3::Z, 0.7, (64, 48)).unwrap()).collect()
    }

    /// The camera in a rotated, scaled and translated world.
    fn moved(camera: &Camera) -> Camera {
        let turn = DMat3::from_rotation_x(1.1) * DMat3::from_rotation_z(2.5);
        let centre = turn * camera.centre() * 0.2 + DVec3::new(5.0, -1.0, 2.0);
        let rotation = camera.rotation * turn.transpose();
        Camera { rotation, translation: -(rotation * centre), ..*camera }
    }

    #[test]
    fn pose_error_ignores_the_world_frame_and_detects_wrong_poses() {
        let truth = cameras();
        let mut found: Vec<Camera> = truth.iter().map(moved).collect();
        let none = PoseErrors::of(&found, &truth).unwrap().largest();
        assert!(none.0 < 1e-4 && none.1 < 1e-9, "{none:?}");
        found[3].rotation = DMat3::from_rotation_y(0.2) * found[3].rotation;
        let one = PoseErrors::of(&found, &truth).unwrap();
        assert!(one.rotations_deg[3] > 8.0 && one.largest().1 > 0.1 && one.agreeing() == 7, "{one:?}");
        assert!(one.medians().0 < 1e-4, "one wrong pose does not affect the others");
        assert!(PoseErrors::of(&found[..2], &truth[..2]).is_none());
        let together = vec![truth[0]; 4];
        assert!(PoseErrors::of(&together, &together).is_none(), "all at the same position");
    }
}
