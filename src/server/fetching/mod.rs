//! Captures that the server fetches itself, from where its operator lets it: no caller can make it reach anything else.

mod fetcher;
mod policy;
mod receiving;

pub(super) use fetcher::Fetcher;
pub use policy::{FetchOrigin, FetchPolicy};
pub(super) use receiving::receive;
