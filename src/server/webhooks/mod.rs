//! Webhooks: what the server sends by itself when jobs end, as [Standard Webhooks](https://www.standardwebhooks.com) has it.

mod dispatcher;
mod policy;
mod routes;
mod schedule;
mod sending;
mod signature;

pub(super) use dispatcher::WebhookDispatcher;
pub use policy::WebhookPolicy;
pub(super) use routes::routes;
