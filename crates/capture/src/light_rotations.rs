//! Rotations of the light by photograph, given separately from a capture.

use std::collections::BTreeMap;

use crate::{Capture, CaptureError};

/// Name of the table in errors.
const TABLE: &str = "light rotations";
/// The error for a name that matches no photograph.
pub(super) const NO_SUCH_PHOTO: &str = "there is no such photograph in the capture";
/// The error for a name that matches several photographs.
pub(super) const SEVERAL_PHOTOS: &str = "several photographs have this name: give more of the path";

impl Capture {
    /// Sets the rotation of the light of the photographs in `degrees`, counter-clockwise about +Z, by file name: the
    /// whole path in the capture or its last parts. The names may be those of training and held-out views.
    ///
    /// # Errors
    /// [`CaptureError::Field`] with a name that matches no photograph or several, or whose rotation is not finite.
    pub fn set_light_rotations(&mut self, degrees: &BTreeMap<String, f64>) -> Result<(), CaptureError> {
        for (name, turn) in degrees {
            let refused = |reason: &str| CaptureError::at_field(TABLE, name.as_str(), reason);
            if !turn.is_finite() {
                return Err(refused("must be finite"));
            }
            let views = self.train.iter_mut().chain(&mut self.test);
            let mut named = views.filter(|view| is_named(&view.name, name));
            let view = named.next().ok_or_else(|| refused(NO_SUCH_PHOTO))?;
            if named.next().is_some() {
                return Err(refused(SEVERAL_PHOTOS));
            }
            view.light_rotation_deg = *turn;
        }
        Ok(())
    }

    /// True when every photograph in `degrees` has the rotation that is given there.
    pub fn has_light_rotations(&self, degrees: &BTreeMap<String, f64>) -> bool {
        let views = self.train.iter().chain(&self.test);
        degrees.iter().all(|(name, turn)| {
            views.clone().any(|view| is_named(&view.name, name) && view.light_rotation_deg == *turn)
        })
    }
}

/// Whether `name` is `path` or the last parts of it.
pub(super) fn is_named(path: &str, name: &str) -> bool {
    path.strip_suffix(name).is_some_and(|before| before.is_empty() || before.ends_with('/'))
        && !name.is_empty()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SyntheticOptions, synthetic};

    #[test]
    fn light_rotation_is_set_by_name_and_unknown_names_are_refused() {
        let options =
            SyntheticOptions { size: 4, train_views: 3, test_views: 1, paths: 4, ..Default::default() };
        let mut capture = synthetic(&options).unwrap();
        let turned = |capture: &mut Capture, name: &str, degrees: f64| {
            capture.set_light_rotations(&[(name.to_owned(), degrees)].into())
        };
        turned(&mut capture, "train_001/rgba.png", 40.0).unwrap();
        turned(&mut capture, "test_000/rgba.png", -5.0).unwrap();
        let degrees: Vec<f64> = capture.train.iter().map(|v| v.light_rotation_deg).collect();
        assert_eq!((degrees, capture.test[0].light_rotation_deg), (vec![0.0, 40.0, 0.0], -5.0));
        for (name, says) in [
            ("train_009/rgba.png", "no such photograph"),
            ("001/rgba.png", "no such photograph"),
            ("", "no such photograph"),
            ("rgba.png", "several photographs"),
        ] {
            let error = turned(&mut capture, name, 1.0).unwrap_err();
            assert_eq!(error.field(), Some(name));
            assert!(error.to_string().contains(says), "{error}");
        }
        assert!(turned(&mut capture, "train_001/rgba.png", f64::NAN).is_err());
    }
}
