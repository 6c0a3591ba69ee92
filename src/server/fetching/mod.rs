//! Captures that the server fetches from other servers. Only origins that the operator permits can be reached.

mod fetcher;
mod policy;
mod receiving;

pub(super) use fetcher::Fetcher;
pub use policy::{FetchOrigin, FetchPolicy};
pub(super) use receiving::receive;
