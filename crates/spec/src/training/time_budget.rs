//! The time that a training may take, in the words of a user.

use std::fmt::{self, Display, Formatter};
use std::ops::RangeInclusive;
use std::str::FromStr;

/// Accepted time budgets, seconds: 30 s to 7 days.
pub const TIME_BUDGET: RangeInclusive<u32> = 30..=604_800;

/// Units of a duration, longest first: letter and seconds.
const UNITS: [(char, u64); 4] = [('d', 86_400), ('h', 3_600), ('m', 60), ('s', 1)];

/// A time budget in whole seconds, within [`TIME_BUDGET`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TimeBudget(pub u32);

impl FromStr for TimeBudget {
    type Err = String;

    /// Parses `90s`, `2m`, `1h30m`, `2h` or `1d`: whole numbers with units, the longest unit first, each at most once.
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = |reason: String| format!("{text:?}: {reason}; write for example 90s, 2m, 1h30m or 2h");
        let (mut seconds, mut digits, mut shorter) = (0u64, String::new(), &UNITS[..]);
        for letter in text.chars() {
            if letter.is_ascii_digit() {
                digits.push(letter);
                continue;
            }
            let Some(at) = UNITS.iter().position(|(unit, _)| *unit == letter) else {
                return Err(wrong(format!("{letter:?} is neither a digit nor one of the units d, h, m, s")));
            };
            let Some(left) = shorter.iter().position(|(unit, _)| *unit == letter) else {
                return Err(wrong(format!("the unit {letter} is repeated or after a shorter one")));
            };
            shorter = &shorter[left + 1..];
            let number: u64 = match digits.is_empty() {
                true => return Err(wrong(format!("the unit {letter} has no number"))),
                false => digits.parse().map_err(|_| wrong("the number is too large".to_owned()))?,
            };
            digits.clear();
            seconds =
                number.checked_mul(UNITS[at].1).and_then(|s| seconds.checked_add(s)).unwrap_or(u64::MAX);
        }
        if !digits.is_empty() {
            return Err(wrong(format!("{digits} has no unit")));
        }
        if text.is_empty() {
            return Err(wrong("it is empty".to_owned()));
        }
        let whole = u32::try_from(seconds).ok().filter(|seconds| TIME_BUDGET.contains(seconds));
        whole.map(Self).ok_or_else(|| wrong("it is outside 30s to 7d".to_owned()))
    }
}

impl Display for TimeBudget {
    /// E.g. `1h30m`.
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let mut left = u64::from(self.0);
        for (unit, length) in UNITS {
            if left >= length {
                write!(f, "{}{unit}", left / length)?;
                left %= length;
            }
        }
        if self.0 == 0 { write!(f, "0s") } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_with_units_parse_and_are_written_back() {
        for (text, seconds) in [
            ("30s", 30),
            ("90s", 90),
            ("2m", 120),
            ("20m", 1_200),
            ("2h", 7_200),
            ("1h30m", 5_400),
            ("1h0m5s", 3_605),
            ("7d", 604_800),
        ] {
            let budget: TimeBudget = text.parse().unwrap();
            assert_eq!(budget, TimeBudget(seconds), "{text}");
            assert_eq!(budget.to_string().parse(), Ok(budget), "{budget}");
        }
        assert_eq!(TimeBudget(5_400).to_string(), "1h30m");
    }

    #[test]
    fn other_texts_are_refused_with_the_reason() {
        for (text, reason) in [
            ("", "is empty"),
            ("120", "120 has no unit"),
            ("2m30", "30 has no unit"),
            ("m", "the unit m has no number"),
            ("2x", "'x' is neither"),
            ("-2m", "'-' is neither"),
            ("1.5h", "'.' is neither"),
            ("2 m", "' ' is neither"),
            ("1m1h", "after a shorter one"),
            ("1m1m", "is repeated"),
            ("29s", "outside 30s to 7d"),
            ("8d", "outside 30s to 7d"),
            ("99999999999999999999s", "too large"),
            ("9999999999999999999d", "outside 30s to 7d"),
        ] {
            let error = text.parse::<TimeBudget>().unwrap_err();
            assert!(error.contains(reason) && error.contains("1h30m"), "{text}: {error}");
        }
    }
}
