//! Shader modules without run-time checks.
#![expect(unsafe_code, reason = "the one call into wgpu that trusts our shaders")]

/// Compiles `source` without bounds checks on memory and loops.
///
/// Invariant that makes this sound: every shader comes from this crate's `shaders/` folder, where each access is
/// guarded by the kernel itself and each loop ends; the test suite runs every kernel with the checks on and off.
pub(super) fn unchecked_module(device: &wgpu::Device, name: &str, source: &str) -> wgpu::ShaderModule {
    let descriptor =
        wgpu::ShaderModuleDescriptor { label: Some(name), source: wgpu::ShaderSource::Wgsl(source.into()) };
    // SAFETY: see the invariant above; `source` is one of `shaders::ALL`.
    unsafe { device.create_shader_module_trusted(descriptor, wgpu::ShaderRuntimeChecks::unchecked()) }
}
