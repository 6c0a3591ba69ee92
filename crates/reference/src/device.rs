//! The GPU device of tests.

use std::sync::LazyLock;

use relume_engine::Device;
use relume_engine::gpu::{Adapters, Gpu, GpuOptions};

/// The first usable adapter, hardware or software, with garbage in new buffers. All tests share it.
///
/// # Panics
/// Without a usable adapter.
#[expect(clippy::expect_used, reason = "a test without its device says what it needs")]
pub fn gpu_device() -> &'static Device {
    static DEVICE: LazyLock<Device> = LazyLock::new(|| {
        let adapters = Adapters::find();
        let usable = adapters.reports().iter().position(|r| r.lacks.is_empty());
        let index = usable.expect("this test needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)");
        let options = GpuOptions { garbage: true, ..GpuOptions::from_env() };
        Device::Gpu(Gpu::open(&adapters, index, options).expect("the adapter opens"))
    });
    &DEVICE
}
