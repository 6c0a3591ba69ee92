//! The importers through the public interface.

// Helpers of tests are tests: a failed one should say where.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod captures;
