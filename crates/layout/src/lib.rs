//! Constants and data layouts that the host and the shaders share.
//!
//! The build script of `relume-engine` depends on this crate and turns it into WGSL, so that each number is written once. The
//! crate has no dependencies and no behaviour.

pub mod channel;
pub mod constants;
mod field;
pub mod kernel_constants;
pub mod light;
mod split;

pub use field::{Field, FieldWidth};
pub use split::{LightSplit, MAX_LIGHTS, SplitLight};
