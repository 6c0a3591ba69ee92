//! Which way is up, where a layout does not say.

use glam::{DQuat, DVec3};

/// The rotation that takes the mean of the cameras' up directions to +Z; none, with a warning, where they agree on none.
pub(super) fn upright(ups: impl Iterator<Item = DVec3>, left_as: &str, warnings: &mut Vec<String>) -> DQuat {
    let ups: Vec<DVec3> = ups.map(DVec3::normalize_or_zero).collect();
    let mean = ups.iter().sum::<DVec3>() / ups.len().max(1) as f64;
    if mean.length() < 0.2 {
        warnings
            .push(format!("the cameras agree on no up direction; the world is left as {left_as} turned it"));
        return DQuat::IDENTITY;
    }
    DQuat::from_rotation_arc(mean.normalize(), DVec3::Z)
}
