//! Parts of lists. A part begins at a place, not at an item: the item may be gone by the time the next part is asked for.

use std::fmt;
use std::str::FromStr;

/// A part of a list, newest first.
#[derive(Debug, Clone, Default)]
pub struct Page {
    /// Most items to return.
    pub limit: u32,
    /// Only items that come after this place.
    pub before: Option<Place>,
}

/// A place in a list, right after an item. As text: the item's identifier, a point, and a number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// What the list is ordered by, largest first: milliseconds since 1970, or a number of its own.
    pub at: i64,
    /// Identifier of the item, which orders those of the same time.
    pub id: String,
}

impl Page {
    /// Identifier of the item that the part comes after.
    pub(super) fn id(&self) -> Option<&str> {
        self.before.as_ref().map(|place| place.id.as_str())
    }

    /// Time of that item.
    pub(super) fn at(&self) -> Option<i64> {
        self.before.as_ref().map(|place| place.at)
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.id, self.at)
    }
}

impl FromStr for Place {
    type Err = NoPlace;

    fn from_str(text: &str) -> Result<Self, NoPlace> {
        let (id, at) = text.rsplit_once('.').ok_or(NoPlace)?;
        let place = Self { at: at.parse().map_err(|_| NoPlace)?, id: id.to_owned() };
        // One text a place: no signs, no zeros in front.
        if place.to_string() == text && !id.is_empty() { Ok(place) } else { Err(NoPlace) }
    }
}

/// The text is no place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoPlace;

/// What stands in a list.
pub trait Placed {
    /// Where.
    fn place(&self) -> Place;
}

/// Records that stand in lists, by the field that orders them.
macro_rules! placed {
    ($($record:ty: $at:ident),+) => {$(
        impl $crate::store::Placed for $record {
            fn place(&self) -> $crate::store::Place {
                $crate::store::Place { at: self.$at, id: self.id.to_string() }
            }
        }
    )+};
}
pub(super) use placed;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_reads_back_from_its_text_and_nothing_else_does() {
        for place in [Place { at: 0, id: "a-1".to_owned() }, Place { at: i64::MAX, id: "b.2".to_owned() }] {
            assert_eq!(place.to_string().parse(), Ok(place));
        }
        for text in ["", "a", "a.", ".5", "a.+5", "a.05", "a.x", "a.99999999999999999999"] {
            assert_eq!(text.parse::<Place>(), Err(NoPlace), "{text}");
        }
    }
}
