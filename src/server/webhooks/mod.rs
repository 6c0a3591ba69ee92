//! Webhooks: what the server sends by itself when jobs end, as [Standard Webhooks](https://www.standardwebhooks.com) has it.

mod courier;
mod policy;
mod routes;
mod schedule;
mod sending;
mod signature;

pub(super) use courier::Courier;
pub use policy::WebhookPolicy;
pub(super) use routes::routes;
