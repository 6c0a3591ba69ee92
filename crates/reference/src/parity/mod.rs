//! The same case computed by every engine: how a view looks, and the gradient of one number made of it. What tests and
//! `relume-bench precision` compare.

mod case;
mod cpu;
mod gpu;
mod reference;

pub use case::{LightShape, ParityCase, ParityResult, SplatSeen};
pub use cpu::by_cpu;
pub use gpu::by_gpu;
pub use reference::{by_reference, steady_pixels};
