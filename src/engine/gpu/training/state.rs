//! A training's state on its way from the host to the device.

use crate::engine::gpu::model::{ModelBuffers, planar};
use crate::engine::gpu::training::Measured;
use crate::engine::gpu::{Buffer, Gpu, GpuError};
use crate::scene::{Gaussians, Model};

/// A training's state on the host, to be taken over.
#[derive(Debug, Clone, Copy)]
pub struct HostState<'a> {
    /// The model.
    pub model: &'a Model,
    /// First and second moments of the Gaussians.
    pub moments: [&'a Gaussians; 2],
    /// First and second moments of prototypes, then environment.
    pub globals: [&'a [[f32; 3]]; 2],
    /// Sum of pulls and steps on screen, by Gaussian.
    pub density: [&'a [f32]; 2],
    /// Probe labels; empty if nothing was measured.
    pub labels: &'a [f32],
    /// Gathered light; empty if nothing was gathered.
    pub gathered: &'a [[f32; 6]],
}

impl HostState<'_> {
    /// The same state in device memory.
    pub(super) fn upload(&self, gpu: &Gpu) -> Result<(ModelBuffers, Buffer<[f32; 2]>, Measured), GpuError> {
        let model = ModelBuffers::upload(gpu, self.model)?;
        for (buffer, moments) in [&model.first, &model.second].into_iter().zip(self.moments) {
            gpu.write(buffer, 0, &planar(moments));
        }
        for (buffer, moments) in [&model.globals_first, &model.globals_second].into_iter().zip(self.globals) {
            gpu.write(buffer, 0, moments.as_flattened());
        }
        let pairs: Vec<[f32; 2]> =
            self.density[0].iter().zip(self.density[1]).map(|(sum, seen)| [*sum, *seen]).collect();
        let density = gpu.upload("density statistics", &pairs)?;
        let some = |data: &[f32], label: &str| {
            if data.is_empty() { Ok(None) } else { gpu.upload(label, data).map(Some) }
        };
        let measured = Measured {
            labels: some(self.labels, "probe labels")?,
            gathered: some(self.gathered.as_flattened(), "gathered light")?,
            ever: !self.labels.is_empty(),
        };
        Ok((model, density, measured))
    }
}
