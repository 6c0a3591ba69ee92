//! Light groups by file name, given separately from a capture.

use std::collections::{BTreeMap, BTreeSet};

use glob::Pattern;

use crate::light_rotations::is_named;
use crate::{Capture, CaptureError, CaptureView};
use relume_scene::MAX_LIGHT_GROUPS;

/// Name of the table in errors.
const TABLE: &str = "light_groups";

impl Capture {
    /// Sets the light group of the photographs whose names match a pattern of `groups`, by group name. `*` stands for any characters, `?` for
    /// one. A pattern matches the path of a photograph in the capture or the end of that path. Other photographs keep their group.
    ///
    /// # Errors
    /// [`CaptureError::Field`] with the group whose pattern is malformed or matches no photograph, with the photograph that several patterns
    /// match, and for more groups than a model can have.
    pub fn set_light_groups(&mut self, groups: &BTreeMap<String, String>) -> Result<(), CaptureError> {
        let mut group_of: BTreeMap<String, &str> = BTreeMap::new();
        for (group, pattern) in groups {
            let refused = |reason: &str| CaptureError::at_field(TABLE, group.as_str(), reason);
            let parsed = Pattern::new(pattern).map_err(|error| refused(&error.to_string()))?;
            let named = self.views().filter(|view| matches(&parsed, &view.name));
            let names: Vec<String> = named.map(|view| view.name.clone()).collect();
            if names.is_empty() {
                return Err(refused("no photograph has a name that matches the pattern"));
            }
            for name in names {
                if let Some(other) = group_of.insert(name.clone(), group) {
                    let reason = format!("the patterns of `{other}` and `{group}` match this photograph");
                    return Err(CaptureError::at_field(TABLE, name.as_str(), reason));
                }
            }
        }
        for view in self.train.iter_mut().chain(&mut self.test) {
            if let Some(group) = group_of.get(&view.name) {
                view.light_group = Some((*group).to_owned());
            }
        }
        self.check_light_groups()
    }

    /// Refuses more light groups than a model can have.
    fn check_light_groups(&self) -> Result<(), CaptureError> {
        let groups: BTreeSet<_> = self.train.iter().map(|view| &view.light_group).collect();
        if groups.len() > MAX_LIGHT_GROUPS {
            let reason = format!(
                "the training photographs have {} light groups; at most {MAX_LIGHT_GROUPS} are accepted",
                groups.len()
            );
            return Err(CaptureError::at_field(TABLE, "light_group", reason));
        }
        Ok(())
    }

    /// The light groups of the training photographs and their numbers of photographs; `None` for one group.
    pub(crate) fn light_groups_in_words(&self) -> Option<String> {
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        for view in &self.train {
            *counts.entry(view.light_group.as_deref().unwrap_or("no group")).or_default() += 1;
        }
        let named = |(name, count): (&&str, &usize)| format!("{name} ({count} photographs)");
        (counts.len() > 1)
            .then(|| format!("light groups: {}", counts.iter().map(named).collect::<Vec<_>>().join(", ")))
    }

    /// True when every photograph that matches a pattern of `groups` has that group.
    pub fn has_light_groups(&self, groups: &BTreeMap<String, String>) -> bool {
        groups.iter().all(|(group, pattern)| {
            Pattern::new(pattern).is_ok_and(|pattern| {
                let mut named = self.views().filter(|view| matches(&pattern, &view.name));
                named.all(|view| view.light_group.as_ref() == Some(group))
            })
        })
    }

    /// Name of the light group of photograph `name`: the whole path in the capture or its last parts. `None` for a photograph that names none,
    /// and without such a photograph.
    pub fn light_group_of(&self, name: &str) -> Option<&str> {
        self.views().find(|view| is_named(&view.name, name))?.light_group.as_deref()
    }

    fn views(&self) -> impl Iterator<Item = &CaptureView> {
        self.train.iter().chain(&self.test)
    }
}

/// Whether `pattern` matches `path` or the last parts of it.
fn matches(pattern: &Pattern, path: &str) -> bool {
    let ends = path.match_indices('/').map(|(at, _)| &path[at + 1..]);
    std::iter::once(path).chain(ends).any(|end| pattern.matches(end))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SyntheticOptions, synthetic};

    fn capture(train_views: usize) -> Capture {
        let options =
            SyntheticOptions { size: 4, train_views, test_views: 1, paths: 4, ..Default::default() };
        synthetic(&options).unwrap()
    }

    fn groups(pairs: &[(&str, &str)]) -> BTreeMap<String, String> {
        pairs.iter().map(|(group, pattern)| ((*group).to_owned(), (*pattern).to_owned())).collect()
    }

    #[test]
    fn light_groups_are_set_by_file_name() {
        let mut capture = capture(4);
        let stated = groups(&[("day", "train_00[01]/*"), ("night", "test_*")]);
        assert!(!capture.has_light_groups(&stated) && capture.facts().count() == 0, "the control");
        capture.set_light_groups(&stated).unwrap();
        let day = Some("day".to_owned());
        let of: Vec<_> = capture.train.iter().map(|view| view.light_group.clone()).collect();
        assert_eq!(of, [day.clone(), day, None, None]);
        assert_eq!(capture.test[0].light_group.as_deref(), Some("night"));
        assert!(capture.has_light_groups(&stated));
        let said = "light groups: day (2 photographs), no group (2 photographs)";
        assert!(capture.facts().any(|fact| fact == said), "{:?}", capture.facts().collect::<Vec<_>>());
        assert_eq!(capture.light_group_of("train_001/rgba.png"), Some("day"));
        assert_eq!(capture.light_group_of("train_003/rgba.png"), None, "the control");
        let end = Pattern::new("IMG_1?.jpg").unwrap();
        assert!(matches(&end, "images/IMG_12.jpg") && !matches(&end, "images/IMG_2.jpg"));
    }

    #[test]
    fn patterns_that_fit_no_or_two_groups_are_refused_by_name() {
        for (pairs, field, says) in [
            (&[("day", "IMG_*")][..], "day", "no photograph"),
            (&[("day", "train_[")], "day", "error"),
            (&[("day", "train_*"), ("night", "*000*")], "train_000/rgba.png", "`day` and `night`"),
        ] {
            let mut capture = capture(3);
            let error = capture.set_light_groups(&groups(pairs)).unwrap_err();
            assert_eq!(error.field(), Some(field));
            assert!(error.to_string().contains(says), "{error}");
            assert!(capture.train.iter().all(|view| view.light_group.is_none()), "unchanged");
        }
    }

    #[test]
    fn more_light_groups_than_a_model_has_are_refused() {
        let own = |count: usize| -> BTreeMap<String, String> {
            (0..count).map(|i| (format!("g{i}"), format!("train_{i:03}/*"))).collect()
        };
        let mut capture = capture(9);
        let error = capture.set_light_groups(&own(9)).unwrap_err();
        assert!(error.to_string().contains("9 light groups"), "{error}");
        assert!(self::capture(9).set_light_groups(&own(7)).is_ok(), "the control: seven and the rest");
    }
}
