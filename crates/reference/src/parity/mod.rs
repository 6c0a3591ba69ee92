//! The same case computed by every engine: how a view looks, and the gradient of one number made of it. What tests and
//! `relume-bench precision` compare.

mod case;
mod cpu;
mod gpu;
mod reference;

pub use case::{LightShape, ParityCase, ParityResult, VisibleSplat};
pub use cpu::cpu_result;
pub use gpu::gpu_result;
pub use reference::{reference_result, stable_pixels};
