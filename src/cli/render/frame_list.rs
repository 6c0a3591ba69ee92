//! The requested frames of a sequence, by their numbers.

use std::str::FromStr;

/// Frame numbers in the syntax of render farms: `7`, `1-10`, `1-100:10`, or several of these separated by commas.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct FrameList(Vec<Range>);

/// From the first number to the last, both included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Range {
    first: u64,
    last: u64,
    step: u64,
}

impl FrameList {
    pub(super) fn contains(&self, number: u64) -> bool {
        let Self(ranges) = self;
        ranges
            .iter()
            .any(|r| (r.first..=r.last).contains(&number) && (number - r.first).is_multiple_of(r.step))
    }

    /// Refuses numbers outside `first` to `last`.
    pub(super) fn check(&self, first: u64, last: u64) -> Result<(), String> {
        let Self(ranges) = self;
        let outside = ranges.iter().flat_map(|r| [r.first, r.last]).find(|n| !(first..=last).contains(n));
        match outside {
            Some(number) => {
                Err(format!("--frames: there is no frame {number}: the frames are {first} to {last}"))
            }
            None => Ok(()),
        }
    }
}

impl FromStr for FrameList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let ranges: Option<Vec<Range>> = text.split(',').map(range).collect();
        ranges.map(Self).ok_or_else(|| "must be like 7, 1-10, 1-100:10 or 1-10,15".to_owned())
    }
}

fn range(text: &str) -> Option<Range> {
    let number = |text: &str| text.parse::<u32>().ok().map(u64::from);
    let (ends, step) = match text.split_once(':') {
        Some((ends, step)) => (ends, number(step)?),
        None => (text, 1),
    };
    let (first, last) = ends.split_once('-').unwrap_or((ends, ends));
    let (first, last) = (number(first)?, number(last)?);
    (first <= last && step > 0).then_some(Range { first, last, step })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_lists_use_the_render_farm_syntax() {
        let of = |text: &str| -> Vec<u64> {
            let list: FrameList = text.parse().unwrap();
            (0..=30).filter(|number| list.contains(*number)).collect()
        };
        assert_eq!(of("7"), [7]);
        assert_eq!(of("0-3"), [0, 1, 2, 3]);
        assert_eq!(of("1-30:10"), [1, 11, 21]);
        assert_eq!(of("20-21,5,4-6:2"), [4, 5, 6, 20, 21]);
        for wrong in ["", "a", "3-1", "1-", "-1", "1-4:0", "1,,2", "1-2-3", "1.5", "1 - 2"] {
            assert!(wrong.parse::<FrameList>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_frame_number_outside_the_sequence_is_refused() {
        let check = |text: &str| text.parse::<FrameList>().unwrap().check(1001, 1010);
        assert_eq!(check("1001-1010"), Ok(()));
        for (outside, number) in [("1000", "1000"), ("1001,1011", "1011"), ("1001-1011", "1011")] {
            assert!(check(outside).unwrap_err().contains(number), "{outside}");
        }
    }
}
