//! The adapters of this machine.

use std::sync::LazyLock;

use crate::adapter::AdapterReport;

/// Workgroup memory that the kernels need, bytes.
pub(super) const WORKGROUP_MEMORY: u32 = 32 << 10;
/// Invocations per workgroup.
pub(super) const INVOCATIONS: u32 = 256;
/// Storage buffers of the kernel with the most bindings.
pub(super) const STORAGE_BUFFERS: u32 = 16;

/// The instance of this process, which is never dropped. Dropping it would unload the driver, but drivers register destructors of
/// thread-local data: with a driver of NVIDIA, each thread that had used the device and ended later crashed the process.
static INSTANCE: LazyLock<wgpu::Instance> = LazyLock::new(|| {
    wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12,
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    })
});

impl AdapterReport {
    fn new(index: usize, adapter: &wgpu::Adapter) -> Self {
        let (info, limits, features) = (adapter.get_info(), adapter.limits(), adapter.features());
        let mut lacks = Vec::new();
        let mut needs = |what: &str, has: u32, least: u32| {
            if has < least {
                lacks.push(format!("{what}: {has}, at least {least} needed"));
            }
        };
        needs("workgroup memory, bytes", limits.max_compute_workgroup_storage_size, WORKGROUP_MEMORY);
        needs("invocations a workgroup", limits.max_compute_invocations_per_workgroup, INVOCATIONS);
        needs("storage buffers a stage", limits.max_storage_buffers_per_shader_stage, STORAGE_BUFFERS);
        Self {
            index,
            name: info.name,
            driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
            backend: info.backend.to_string(),
            software: info.device_type == wgpu::DeviceType::Cpu,
            max_binding: limits.max_storage_buffer_binding_size,
            max_buffer: limits.max_buffer_size,
            workgroup_memory: limits.max_compute_workgroup_storage_size,
            float_atomics: features.contains(wgpu::Features::SHADER_FLOAT32_ATOMIC),
            timestamps: features.contains(wgpu::Features::TIMESTAMP_QUERY),
            lacks,
        }
    }
}

/// The adapters of this machine, in a stable order.
pub struct Adapters {
    adapters: Vec<wgpu::Adapter>,
    reports: Vec<AdapterReport>,
}

impl Adapters {
    /// Finds the adapters. The list may be empty.
    pub fn find() -> Self {
        let adapters = pollster::block_on(INSTANCE.enumerate_adapters(wgpu::Backends::all()));
        let reports = adapters.iter().enumerate().map(|(i, a)| AdapterReport::new(i, a)).collect();
        Self { adapters, reports }
    }

    /// A report per adapter.
    pub fn reports(&self) -> &[AdapterReport] {
        &self.reports
    }

    pub(super) fn adapter(&self, index: usize) -> Option<(&wgpu::Adapter, &AdapterReport)> {
        self.adapters.get(index).zip(self.reports.get(index))
    }
}
