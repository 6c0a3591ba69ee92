//! Checks of numbers against their accepted ranges.

use std::fmt::Display;
use std::ops::RangeInclusive;

use serde::Serialize;

use crate::training::ConfigError;

/// # Errors
/// `field` with the accepted range, if `value` is outside of it.
pub(super) fn check_range<T: PartialOrd + Display>(
    field: &str,
    value: T,
    range: RangeInclusive<T>,
) -> Result<(), ConfigError> {
    if range.contains(&value) {
        return Ok(());
    }
    Err(ConfigError::new(field, format!("{value} is outside {}", range_text(&range))))
}

/// The range in words.
pub(super) fn range_text(range: &RangeInclusive<impl Display>) -> String {
    format!("{} to {}", range.start(), range.end())
}

/// Accepted range of weights and step sizes.
pub(super) const GROUP_RANGE: RangeInclusive<f64> = 0.0..=1e3;

/// Checks that every number of `group` is in [`GROUP_RANGE`].
///
/// # Errors
/// The first field that is not.
pub(super) fn check_group(name: &str, group: &impl Serialize) -> Result<(), ConfigError> {
    let fields = serde_json::to_value(group).unwrap_or_default();
    for (field, value) in fields.as_object().into_iter().flatten() {
        // A non-finite float serialises as null.
        if !value.as_f64().is_some_and(|v| GROUP_RANGE.contains(&v)) {
            return Err(ConfigError::new(
                format!("{name}.{field}"),
                format!("must be {}", range_text(&GROUP_RANGE)),
            ));
        }
    }
    Ok(())
}
