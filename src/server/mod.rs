//! The HTTP service: one file for each family of endpoints, with its routes, documentation and refusals.

// A refusal is made at most once a request; the cost of moving it does not matter.
#![allow(clippy::result_large_err)]

mod access;
mod app;
mod auth;
mod caller;
mod cameras;
mod captures;
mod connections;
mod decoders;
mod deletion;
mod description;
mod encoders;
mod environments;
mod events;
mod extract;
mod fetching;
mod file_form;
mod files;
mod health;
mod job_bounds;
mod jobs;
mod keeper;
mod keyring;
mod keys;
mod lights;
mod listing;
mod machine;
mod marks;
mod memory;
mod models;
mod negotiate;
mod observe;
mod opened_captures;
mod origins;
mod outbound;
mod photographs;
mod places;
mod poses;
mod previews;
mod problem;
mod quality_gate;
mod rates;
mod render_request;
mod renders;
mod router;
mod run;
mod same_site;
mod signed_urls;
mod signing;
mod signing_secret;
mod stack;
mod thumbnail_cache;
mod thumbnails;
mod turns;
mod upload;
mod uploads;
mod usage;
mod validation;
mod viewer;
#[cfg(feature = "web")]
mod web;
mod webhooks;

pub use app::RequestLimits;
pub use auth::ApiKeys;
pub use connections::{ConnectionLimits, raise_file_limit};
pub use fetching::{FetchOrigin, FetchPolicy};
pub use origins::CorsOrigin;
pub use poses::PosesPolicy;
pub use router::openapi;
pub use run::{ServeError, ServerConfig, run};
pub use signing_secret::rotate_signing_secret;
pub use webhooks::WebhookPolicy;
