//! Captures through the public importer: real sets where the test data is there, made ones and hostile ones
//! always.

#![allow(clippy::unwrap_used)]

mod archives;
mod bad_input;
mod layouts;
mod real;
mod small_set;
