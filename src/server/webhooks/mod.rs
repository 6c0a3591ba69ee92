//! Webhooks: what the server sends by itself when jobs end, as [Standard Webhooks](https://www.standardwebhooks.com) has it.

mod courier;
mod routes;
mod schedule;
mod sending;
mod signature;
mod target;
mod tls;

pub(super) use courier::Courier;
pub(super) use routes::routes;
pub use target::WebhookPolicy;
