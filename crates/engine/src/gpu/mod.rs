//! The GPU engine: the model of `docs/MODEL.md` in WGSL (`shaders/`), on any Vulkan, Metal or DX12 device.
//!
//! One module per family of kernels. Each module has the buffers of its kernels and the tests that compare the kernels with
//! the CPU engine. The shaders document data layouts where they declare them (`shaders/shared/`).

mod adapter;
mod attribute_source;
mod bind_groups;
mod buffer;
mod camera;
mod counters;
mod density;
mod device;
pub mod frame;
pub mod frames;
pub mod gather;
mod grow;
pub mod light;
mod lock;
pub mod model;
pub mod objective;
mod permutations;
mod photo_pixel;
pub mod probes;
pub mod raster;
pub mod rays;
mod readback;
mod recorder;
pub mod resolve;
mod scan;
mod self_test;
pub mod shaders;
pub mod shading;
mod sort;
#[cfg(test)]
mod tests;
mod timing;
pub mod training;
mod trusted;
pub mod update;

pub use adapter::Adapters;
pub use attribute_source::AttributeSource;
pub use buffer::Buffer;
pub use camera::{CameraUniform, TILE};
pub use counters::DeviceCounts;
pub use device::{Gpu, GpuOptions};
pub use frames::GpuFrameRenderer;
pub use permutations::groups;
pub use photo_pixel::{DevicePhoto, PhotoPixel, photo_pixel};
pub use raster::Raster;
pub use readback::{InFlightLimit, ReadbackData, ReadbackTicket, Submission};
pub use recorder::{Bind, Groups, Recorder, uniform};
pub use timing::StageTime;
pub use training::GpuTraining;
