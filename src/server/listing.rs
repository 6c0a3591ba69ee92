//! Lists: newest first, a page at a time.

use serde::Deserialize;
use utoipa::IntoParams;

use crate::api::{List, Problem};
use crate::store::Page;

pub(super) use crate::store::rfc3339;

const MOST: u32 = 200;
const DEFAULT: u32 = 50;

/// Which part of a list.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PageQuery {
    /// Most items, 1 to 200; 50 when absent.
    #[param(minimum = 1, maximum = 200)]
    pub limit: Option<u32>,
    /// Only items older than this identifier: the `next` of the page before.
    #[param(min_length = 1)]
    pub before: Option<String>,
}

/// A page that was asked for.
#[derive(Debug)]
pub(super) struct Asked {
    limit: u32,
    before: Option<String>,
}

impl PageQuery {
    /// The page asked for.
    ///
    /// # Errors
    /// Names `limit` when it is out of range.
    pub(super) fn page(self) -> Result<Asked, Problem> {
        let limit = self.limit.unwrap_or(DEFAULT);
        if !(1..=MOST).contains(&limit) {
            return Err(Problem::invalid_field("query/limit", format!("must be 1 to {MOST}, got {limit}")));
        }
        Ok(Asked { limit, before: self.before })
    }
}

impl Asked {
    /// Where the page begins.
    pub(super) fn before(&self) -> Option<&str> {
        self.before.as_deref()
    }

    /// What the store is asked for: one item more than the page has, which tells whether there is a next one.
    pub(super) fn of_store(&self) -> Page {
        Page { limit: self.limit + 1, before: self.before.clone() }
    }

    /// The answer from what the store gave; `id` gives an item's identifier.
    pub(super) fn list<T>(&self, mut items: Vec<T>, id: impl Fn(&T) -> &str) -> List<T> {
        let has_more = items.len() > self.limit as usize;
        items.truncate(self.limit as usize);
        let next = items.last().filter(|_| has_more).map(|item| id(item).to_owned());
        List { items, next }
    }
}

/// 422 for a page that begins nowhere.
pub(super) fn unknown_cursor(before: &str) -> Problem {
    Problem::invalid_field("query/before", format!("{before:?} is not an item of this list"))
}
