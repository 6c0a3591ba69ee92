//! Lists: newest first, a page at a time.

use serde::Deserialize;
use utoipa::IntoParams;

use crate::api::{List, Problem};
use crate::store::Page;

const MOST: u32 = 200;
const DEFAULT: u32 = 50;

/// Which part of a list.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PageQuery {
    /// Most items, 1 to 200; 50 when absent.
    pub limit: Option<u32>,
    /// Only items older than this identifier: the `next` of the page before.
    pub before: Option<String>,
}

impl PageQuery {
    /// The page as the store takes it.
    ///
    /// # Errors
    /// Names `limit` when it is out of range.
    pub(super) fn page(&self) -> Result<Page, Problem> {
        page(self.limit, self.before.clone())
    }
}

pub(super) fn page(limit: Option<u32>, before: Option<String>) -> Result<Page, Problem> {
    let limit = limit.unwrap_or(DEFAULT);
    if !(1..=MOST).contains(&limit) {
        return Err(Problem::invalid_field("query/limit", format!("must be 1 to {MOST}, got {limit}")));
    }
    Ok(Page { limit, before })
}

/// A page of `items`; `id` gives an item's identifier.
pub(super) fn list<T>(items: Vec<T>, page: &Page, id: impl Fn(&T) -> &str) -> List<T> {
    let full = items.len() == page.limit as usize;
    let next = items.last().filter(|_| full).map(|item| id(item).to_owned());
    List { items, next }
}

/// Milliseconds since 1970 as RFC 3339.
pub(super) fn rfc3339(ms: i64) -> String {
    jiff::Timestamp::from_millisecond(ms).unwrap_or_default().to_string()
}
