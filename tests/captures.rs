//! Captures through the public importer: real sets where the test data is there, hostile ones always.

#![allow(clippy::unwrap_used)]

mod real;
