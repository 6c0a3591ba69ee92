//! The importers through the public interface.

// Test helpers may panic: the panic names the place.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod captures;
