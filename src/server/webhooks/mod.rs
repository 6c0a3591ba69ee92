//! Webhooks: messages about the ends of jobs, according to [Standard Webhooks](https://www.standardwebhooks.com).

mod dispatcher;
mod policy;
mod routes;
mod schedule;
mod sending;
mod signature;

pub(super) use dispatcher::WebhookDispatcher;
pub use policy::WebhookPolicy;
pub(super) use routes::routes;
