//! Which direction in the files of a capture becomes +Z: what a caller asks for, and what an import used.

use glam::{DQuat, DVec3};
use relume_spec::training::UpAxis;
use serde::{Deserialize, Serialize};

/// The up direction that a caller of an import asks for.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Up(pub(super) Choice);

#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) enum Choice {
    #[default]
    Auto,
    Mean,
    /// Unit length.
    Direction(DVec3),
}

impl Up {
    /// The direction that the layout states, otherwise that of the ground or of the cameras.
    pub const AUTO: Self = Self(Choice::Auto);
    /// The direction that the layout states, otherwise the mean up direction of the cameras, or the axis around which they turn if
    /// they were held sideways. Models that do not record their direction ([`WorldUp::direction`]) have this one.
    pub const MEAN: Self = Self(Choice::Mean);

    /// A direction in the axes of the files, of any length. `None` if it is zero or not finite.
    pub fn direction(direction: [f64; 3]) -> Option<Self> {
        let direction = DVec3::from_array(direction);
        // A recorded direction stays as it is, so that the rotation is the same to the last bit.
        let unit = if direction.is_normalized() { Some(direction) } else { direction.try_normalize() };
        unit.map(|unit| Self(Choice::Direction(unit)))
    }

    /// The stated direction, or +Z.
    pub(super) fn stated(self) -> WorldUp {
        match self.0 {
            Choice::Direction(direction) => WorldUp::stated(direction),
            Choice::Auto | Choice::Mean => WorldUp::default(),
        }
    }
}

impl From<UpAxis> for Up {
    fn from(axis: UpAxis) -> Self {
        let unit = match axis {
            UpAxis::Auto => return Self::AUTO,
            UpAxis::X => DVec3::X,
            UpAxis::Y => DVec3::Y,
            UpAxis::Z => DVec3::Z,
            UpAxis::NegX => DVec3::NEG_X,
            UpAxis::NegY => DVec3::NEG_Y,
            UpAxis::NegZ => DVec3::NEG_Z,
        };
        Self(Choice::Direction(unit))
    }
}

/// The direction in the files of a capture that an import rotated to +Z.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WorldUp {
    /// Unit length, in the axes of the files. An import with [`Up::direction`] of it has the same world.
    pub direction: [f64; 3],
    /// The evidence for the direction, a sentence that starts with "up:". `None` if the layout or the caller states it.
    pub note: Option<String>,
}

impl Default for WorldUp {
    /// +Z: the world is not rotated.
    fn default() -> Self {
        Self::stated(DVec3::Z)
    }
}

impl WorldUp {
    /// A unit vector that the layout or the caller states.
    pub(super) fn stated(direction: DVec3) -> Self {
        Self { direction: rounded(direction), note: None }
    }

    /// A unit vector with the evidence for it.
    pub(super) fn found(direction: DVec3, note: String) -> Self {
        Self { direction: rounded(direction), note: Some(note) }
    }

    /// The rotation from the axes of the files to those of the capture.
    pub fn rotation(&self) -> DQuat {
        DQuat::from_rotation_arc(DVec3::from_array(self.direction).normalize(), DVec3::Z)
    }
}

/// The components rounded to 12 decimals, so that they are the same after writing to and reading from JSON.
fn rounded(direction: DVec3) -> [f64; 3] {
    direction.to_array().map(|component| (component * 1e12).round() / 1e12 + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn direction_without_a_length_is_refused() {
        for bad in [[0.0; 3], [f64::NAN, 0.0, 1.0], [f64::INFINITY, 0.0, 0.0]] {
            assert_eq!(Up::direction(bad), None, "{bad:?}");
        }
        let Some(Up(Choice::Direction(unit))) = Up::direction([0.0, 3.0, 0.0]) else { panic!("the control") };
        assert_eq!((unit, Up::from(UpAxis::Y)), (DVec3::Y, Up(Choice::Direction(DVec3::Y))));
        assert_eq!(Up::from(UpAxis::Auto), Up::default());
    }

    #[test]
    fn direction_read_from_json_gives_the_same_rotation() {
        for i in 0..200 {
            let angle = f64::from(i);
            let found = WorldUp::stated(DVec3::new(angle.sin(), (1.7 * angle).cos(), 0.3).normalize());
            let json = serde_json::to_string(&found).unwrap();
            let read: WorldUp = serde_json::from_str(&json).unwrap();
            let Some(Up(Choice::Direction(direction))) = Up::direction(read.direction) else {
                panic!("{json}")
            };
            assert_eq!(WorldUp::stated(direction).rotation(), found.rotation(), "{json}");
        }
    }

    #[test]
    fn world_without_rotation_has_the_identity() {
        assert_eq!(WorldUp::default().rotation(), DQuat::IDENTITY);
        let turn = WorldUp::stated(DVec3::Y).rotation();
        assert!((turn * DVec3::Y - DVec3::Z).length() < 1e-12);
    }
}
