//! Pages of lists. A page begins at a cursor, not at an item, because the item may be deleted before the next page is requested.

use std::fmt;
use std::str::FromStr;

/// A page of a list, newest first.
#[derive(Debug, Clone, Default)]
pub struct Page {
    /// Maximum number of items.
    pub limit: u32,
    /// Only items after this cursor.
    pub before: Option<PageCursor>,
}

/// A position in a list, directly after an item. Its text has the item's identifier, a point and a number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PageCursor {
    /// The value that orders the list, largest first: milliseconds since 1970, or a number of the list.
    pub at: i64,
    /// Identifier of the item, which orders items with the same value.
    pub id: String,
}

impl Page {
    /// Identifier of the item before the page.
    pub(super) fn id(&self) -> Option<&str> {
        self.before.as_ref().map(|cursor| cursor.id.as_str())
    }

    /// Ordering value of that item.
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
        // Each cursor has a single text: no signs, no leading zeros.
        if cursor.to_string() == text && !id.is_empty() { Ok(cursor) } else { Err(InvalidCursor) }
    }
}

/// The text is not a cursor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InvalidCursor;

/// An item of a list.
pub trait Paginated {
    /// The position after the item.
    fn cursor(&self) -> PageCursor;
}

/// Implements [`Paginated`] for records, by the field that orders them.
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
