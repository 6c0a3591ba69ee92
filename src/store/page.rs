//! Parts of lists. A part begins at a cursor, not at an item: the item may be gone by the time the next part is asked for.

use std::fmt;
use std::str::FromStr;

/// A part of a list, newest first.
#[derive(Debug, Clone, Default)]
pub struct Page {
    /// Most items to return.
    pub limit: u32,
    /// Only items that come after this cursor.
    pub before: Option<PageCursor>,
}

/// A cursor in a list, right after an item. As text: the item's identifier, a point, and a number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PageCursor {
    /// What the list is ordered by, largest first: milliseconds since 1970, or a number of its own.
    pub at: i64,
    /// Identifier of the item, which orders those of the same time.
    pub id: String,
}

impl Page {
    /// Identifier of the item that the part comes after.
    pub(super) fn id(&self) -> Option<&str> {
        self.before.as_ref().map(|cursor| cursor.id.as_str())
    }

    /// Time of that item.
    pub(super) fn at(&self) -> Option<i64> {
        self.before.as_ref().map(|cursor| cursor.at)
    }
}

impl fmt::Display for PageCursor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.id, self.at)
    }
}

impl FromStr for PageCursor {
    type Err = InvalidCursor;

    fn from_str(text: &str) -> Result<Self, InvalidCursor> {
        let (id, at) = text.rsplit_once('.').ok_or(InvalidCursor)?;
        let cursor = Self { at: at.parse().map_err(|_| InvalidCursor)?, id: id.to_owned() };
        // One text a cursor: no signs, no zeros in front.
        if cursor.to_string() == text && !id.is_empty() { Ok(cursor) } else { Err(InvalidCursor) }
    }
}

/// The text is no cursor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InvalidCursor;

/// What stands in a list.
pub trait Paginated {
    /// Where.
    fn cursor(&self) -> PageCursor;
}

/// Records that stand in lists, by the field that orders them.
macro_rules! paginated {
    ($($record:ty: $at:ident),+) => {$(
        impl $crate::store::Paginated for $record {
            fn cursor(&self) -> $crate::store::PageCursor {
                $crate::store::PageCursor { at: self.$at, id: self.id.to_string() }
            }
        }
    )+};
}
pub(super) use paginated;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_cursors_round_trip_and_invalid_ones_are_refused() {
        for cursor in
            [PageCursor { at: 0, id: "a-1".to_owned() }, PageCursor { at: i64::MAX, id: "b.2".to_owned() }]
        {
            assert_eq!(cursor.to_string().parse(), Ok(cursor));
        }
        for text in ["", "a", "a.", ".5", "a.+5", "a.05", "a.x", "a.99999999999999999999"] {
            assert_eq!(text.parse::<PageCursor>(), Err(InvalidCursor), "{text}");
        }
    }
}
