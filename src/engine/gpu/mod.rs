//! The GPU engine: the model of `docs/MODEL.md` in WGSL (`shaders/`), on any Vulkan, Metal or DX12 device.
//!
//! One file a family of kernels; each host file holds the buffers its kernels work on and the tests that hold them
//! against the CPU engine. Data layouts are written down where the shaders declare them (`shaders/shared/`).

mod adapter;
mod buffer;
mod device;
mod error;
pub mod light;
pub mod losses;
pub mod model;
mod recorder;
pub mod shaders;
pub mod shading;
#[cfg(test)]
mod tests;
mod trusted;
mod view;

pub use adapter::{AdapterReport, Adapters, DeviceChoice};
pub use buffer::Buffer;
pub use device::{Gpu, GpuOptions};
pub use error::GpuError;
pub use recorder::{Bind, Groups, Recorder, uniform};
pub use view::{SplatRecord, TILE, ViewUniform};
