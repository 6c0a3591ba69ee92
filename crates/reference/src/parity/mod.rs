//! One case on every engine: the images of a view, and the gradient of a scalar computed from them. Tests and
//! `relume-bench precision` compare the results.

mod case;
mod cpu;
mod gpu;
mod reference;

pub use case::{LightShape, ParityCase, ParityResult, VisibleSplat};
pub use cpu::cpu_result;
pub use gpu::gpu_result;
pub use reference::{reference_result, stable_pixels};
