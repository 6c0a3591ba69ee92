//! Numbers and layouts that the host and the shaders of Relume share. The build script of `relume-engine` turns them into
//! WGSL, so that no number is written twice. No dependency.

pub mod channel;
pub mod constants;
mod field;
pub mod kernel_constants;
pub mod light;
mod split;

pub use field::{Field, FieldWidth};
pub use split::{LightSplit, MAX_LIGHTS, SplitLight};
