//! The f64 reference engine against the article's listing, against central differences, and against physical laws.

#![allow(clippy::unwrap_used)]

mod fixtures;
mod gradients;
mod laws;
mod objective;
mod parity;
