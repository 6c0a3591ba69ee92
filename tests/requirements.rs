//! What ignored tests need: a GPU or the data folder. Both functions panic where it is missing.
//!
//! Tests that need a GPU have `gpu` in their path, tests that need the data folder are in modules named `with_data`.

use std::path::PathBuf;
use std::sync::LazyLock;

use relume_engine::Device;
use relume_engine::gpu::{Adapters, Gpu, GpuOptions};

/// The first usable adapter, software or not, with garbage in fresh buffers. Shared by all tests.
pub fn gpu_device() -> &'static Device {
    static DEVICE: LazyLock<Device> = LazyLock::new(|| {
        let adapters = Adapters::find();
        let usable = adapters.reports().iter().position(|r| r.lacks.is_empty());
        let index = usable.expect("this test needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)");
        let options = GpuOptions { garbage: true, ..GpuOptions::from_env() };
        Device::Gpu(Gpu::open(&adapters, index, options).unwrap())
    });
    &DEVICE
}

/// A file or folder of the test data.
pub fn data(relative: &str) -> PathBuf {
    let root = std::env::var_os("RELUME_TEST_DATA")
        .expect("this test needs RELUME_TEST_DATA, the folder of test data (see CONTRIBUTING.md)");
    let path = PathBuf::from(root).join(relative);
    assert!(path.exists(), "the test data has no {}", path.display());
    path
}
