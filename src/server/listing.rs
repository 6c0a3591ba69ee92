//! Lists in pages, newest first.

use serde::Deserialize;
use utoipa::IntoParams;

use crate::server::problem::Problem;
use crate::store::{InvalidCursor, Page, Paginated, StoreError};
use relume_api::List;

pub(super) use crate::store::rfc3339;

const MAX_LIMIT: u32 = 200;
const DEFAULT_LIMIT: u32 = 50;

/// Page of a list.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PageQuery {
    /// Maximum number of items, 1 to 200. Omitted: 50.
    #[param(minimum = 1, maximum = 200)]
    pub limit: Option<u32>,
    /// Cursor: the `next` of the previous page, or the identifier of an item. The page starts after that
    /// item. Omitted: the first page.
    #[param(min_length = 1)]
    pub before: Option<String>,
}

/// A requested page.
#[derive(Debug)]
pub(super) struct PageRequest(Page);

impl PageQuery {
    /// The requested page. `find` finds an item of the list, for clients that send an identifier instead of a `next`.
    ///
    /// # Errors
    /// Names `limit` if it is out of range, and `before` if it is invalid.
    pub(super) async fn page<R: Paginated>(
        self,
        find: impl AsyncFnOnce(&str) -> Result<Option<R>, StoreError>,
    ) -> Result<PageRequest, Problem> {
        let limit = self.limit.unwrap_or(DEFAULT_LIMIT);
        if !(1..=MAX_LIMIT).contains(&limit) {
            return Err(Problem::invalid_field(
                "query/limit",
                format!("must be 1 to {MAX_LIMIT}, got {limit}"),
            ));
        }
        let before = match self.before {
            None => None,
            Some(text) => match text.parse() {
                Ok(cursor) => Some(cursor),
                Err(InvalidCursor) => {
                    let unknown = format!("{text:?} is not an item of this list");
                    let item = find(&text).await?;
                    Some(item.ok_or_else(|| Problem::invalid_field("query/before", unknown))?.cursor())
                }
            },
        };
        Ok(PageRequest(Page { limit, before }))
    }
}

impl PageRequest {
    /// The query for the store, with one item more than the page, which shows whether there is a next page.
    pub(super) fn store_page(&self) -> Page {
        Page { limit: self.0.limit + 1, before: self.0.before.clone() }
    }

    /// The items of the page, and the cursor of the next page.
    pub(super) fn cut<R: Paginated>(&self, mut records: Vec<R>) -> (Vec<R>, Option<String>) {
        let limit = self.0.limit as usize;
        let has_more = records.len() > limit;
        records.truncate(limit);
        let next = records.last().filter(|_| has_more).map(|record| record.cursor().to_string());
        (records, next)
    }

    /// The answer for records of the store.
    pub(super) fn list<R: Paginated, T>(&self, records: Vec<R>, view: impl FnMut(R) -> T) -> List<T> {
        let (records, next) = self.cut(records);
        List { items: records.into_iter().map(view).collect(), next }
    }
}
