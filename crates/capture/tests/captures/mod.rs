//! Captures through the public importer: made ones, hostile ones, and real ones
//! from the test data.

#![allow(clippy::unwrap_used)]

mod archives;
mod bad_input;
mod layouts;
mod with_data;
