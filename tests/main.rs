//! Black-box tests, one module a subject, one binary.

// Helpers of tests are tests: a failed one should say where.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod architecture;
mod captures;
mod eval;
mod service;
mod service_support;
