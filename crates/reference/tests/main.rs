//! The f64 reference engine and comparisons of the engines with it.

// Helpers of tests are tests: a failed one should say where.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod extremes;
mod reference;
