//! Captures through the public importer: generated, hostile, and real ones from the test data.

#![allow(clippy::unwrap_used)]

mod archives;
mod bad_input;
mod layouts;
mod masks;
mod pixels;
mod rig;
mod scene_referred;
mod variants;
mod with_data;
