//! Light groups: sets of photographs that share a light.

use std::collections::BTreeMap;

use crate::training::ConfigError;

/// Largest number of bytes of the name of a light group.
const MAX_NAME: usize = 64;
/// What a name of a light group must be.
pub const LIGHT_GROUP_NAME: &str = "must have 1 to 64 letters, digits, `-`, `_` or `.`";

/// Whether `name` can be the name of a light group.
pub fn is_light_group_name(name: &str) -> bool {
    let accepted = |c: char| c.is_alphanumeric() || matches!(c, '-' | '_' | '.');
    (1..=MAX_NAME).contains(&name.len()) && name.chars().all(accepted)
}

/// Checks names and patterns of `groups`.
///
/// # Errors
/// Names the group at fault.
pub(super) fn check(groups: &BTreeMap<String, String>) -> Result<(), ConfigError> {
    for (name, pattern) in groups {
        let field = format!("light_groups.{name}");
        if !is_light_group_name(name) {
            return Err(ConfigError::new(field, format!("the name {LIGHT_GROUP_NAME}")));
        }
        if pattern.is_empty() {
            return Err(ConfigError::new(field, "the pattern must not be empty"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_light_groups_are_short_words() {
        for good in ["evening", "flash-2", "a.b_c", "夜"] {
            assert!(is_light_group_name(good), "{good}");
        }
        for bad in ["", "two words", "a/b", "a:b", &"x".repeat(65), "a\n"] {
            assert!(!is_light_group_name(bad), "{bad}");
            let error = check(&[(bad.to_owned(), "*".to_owned())].into()).unwrap_err();
            assert!(error.to_string().contains("light_groups."), "{error}");
        }
        assert!(check(&[("day".to_owned(), String::new())].into()).is_err());
        assert!(check(&[("day".to_owned(), "IMG_1*".to_owned())].into()).is_ok(), "the control");
    }
}
