//! The up direction of layouts that do not state one.

use glam::{DQuat, DVec3};

/// The rotation that takes the mean of the cameras' up directions to +Z. If they have no common up direction: the
/// identity, with a warning.
pub(super) fn upright(ups: impl Iterator<Item = DVec3>, left_as: &str, warnings: &mut Vec<String>) -> DQuat {
    let ups: Vec<DVec3> = ups.map(DVec3::normalize_or_zero).collect();
    let mean = ups.iter().sum::<DVec3>() / ups.len().max(1) as f64;
    if mean.length() < 0.2 {
        warnings.push(format!("the cameras have no common up direction; the world keeps its {left_as} axes"));
        return DQuat::IDENTITY;
    }
    DQuat::from_rotation_arc(mean.normalize(), DVec3::Z)
}
