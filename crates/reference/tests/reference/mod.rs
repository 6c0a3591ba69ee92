//! The f64 reference engine: against the article's own listing, against central differences, and against the
//! laws its parts must obey.

#![allow(clippy::unwrap_used)]

mod fixtures;
mod gradients;
mod laws;
mod objective;
mod parity;
