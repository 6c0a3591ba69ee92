//! Lists: newest first, a page at a time.

use serde::Deserialize;
use utoipa::IntoParams;

use crate::api::{List, Problem};
use crate::store::{NoPlace, Page, Placed, StoreError};

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
    /// Only what comes after: the `next` of the page before, or the identifier of an item.
    #[param(min_length = 1)]
    pub before: Option<String>,
}

/// A page that was asked for.
#[derive(Debug)]
pub(super) struct Asked(Page);

impl PageQuery {
    /// The page asked for. `find` looks for an item of the list, for callers who name one instead of a `next`.
    ///
    /// # Errors
    /// Names `limit` when it is out of range, and `before` when it is neither.
    pub(super) async fn page<R: Placed>(
        self,
        find: impl AsyncFnOnce(&str) -> Result<Option<R>, StoreError>,
    ) -> Result<Asked, Problem> {
        let limit = self.limit.unwrap_or(DEFAULT);
        if !(1..=MOST).contains(&limit) {
            return Err(Problem::invalid_field("query/limit", format!("must be 1 to {MOST}, got {limit}")));
        }
        let before = match self.before {
            None => None,
            Some(text) => match text.parse() {
                Ok(place) => Some(place),
                Err(NoPlace) => {
                    let unknown = format!("{text:?} is not an item of this list");
                    let item = find(&text).await?;
                    Some(item.ok_or_else(|| Problem::invalid_field("query/before", unknown))?.place())
                }
            },
        };
        Ok(Asked(Page { limit, before }))
    }
}

impl Asked {
    /// What the store is asked for: one item more than the page has, which tells whether there is a next one.
    pub(super) fn of_store(&self) -> Page {
        Page { limit: self.0.limit + 1, before: self.0.before.clone() }
    }

    /// The page's part of what the store gave, and where the next one begins.
    pub(super) fn cut<R: Placed>(&self, mut records: Vec<R>) -> (Vec<R>, Option<String>) {
        let limit = self.0.limit as usize;
        let has_more = records.len() > limit;
        records.truncate(limit);
        let next = records.last().filter(|_| has_more).map(|record| record.place().to_string());
        (records, next)
    }

    /// The answer from what the store gave.
    pub(super) fn list<R: Placed, T>(&self, records: Vec<R>, view: impl FnMut(R) -> T) -> List<T> {
        let (records, next) = self.cut(records);
        List { items: records.into_iter().map(view).collect(), next }
    }
}
