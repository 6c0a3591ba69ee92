//! The f64 reference engine and comparisons of the engines with it.

// Test helpers may panic: the panic names the place.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod extremes;
mod reference;
