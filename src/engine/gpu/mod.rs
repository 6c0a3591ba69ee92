//! The GPU engine: the model of `docs/MODEL.md` in WGSL (`shaders/`), on any Vulkan, Metal or DX12 device.
//!
//! One file a family of kernels; each host file holds the buffers its kernels work on and the tests that hold them
//! against the CPU engine. Data layouts are written down where the shaders declare them (`shaders/shared/`).

mod adapter;
mod attributes;
mod buffer;
pub mod density;
pub mod develop;
mod device;
mod error;
pub mod gather;
mod kernel_constants;
pub mod light;
pub mod losses;
pub mod model;
pub mod probes;
pub mod raster;
mod recorder;
mod scan;
pub mod shaders;
pub mod shading;
mod sort;
#[cfg(test)]
mod tests;
pub mod training;
mod trusted;
pub mod update;
mod view;

pub use adapter::{AdapterReport, Adapters, DeviceChoice};
pub use attributes::AttributeBuffers;
pub use buffer::Buffer;
pub use device::{Gpu, GpuOptions};
pub use error::GpuError;
pub use gather::{GatherSource, gather};
pub use probes::{ProbeBuffers, Probes};
pub use raster::{Raster, RasterCounts};
pub use recorder::{Bind, Groups, Recorder, StageTime, uniform};
pub use scan::{Scan, grow};
pub use sort::{Pairs, Sorter};
pub use view::{CameraUniform, SplatRecord, TILE};
