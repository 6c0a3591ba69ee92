//! All that a training has learned, in device memory.

use crate::engine::DeviceError;
use crate::engine::gpu::density::read_stats;
use crate::engine::gpu::light::TrainingLight;
use crate::engine::gpu::model::{ModelBuffers, planar};
use crate::engine::gpu::{AttributeSource, Buffer, Gpu};
use crate::engine::{Moments, TrainState};
use crate::scene::Model;

/// What is measured, not learned.
#[derive(Debug, Clone)]
pub(super) struct Measured {
    /// Probe labels, `[Gaussian][coefficient]`.
    pub(super) labels: Option<Buffer<f32>>,
    /// Gathered light, 6 floats a Gaussian.
    pub(super) gathered: Option<Buffer<f32>>,
    /// True once anything was measured, also for Gaussians that are gone.
    pub(super) ever: bool,
}

impl Measured {
    /// Drops what was measured of Gaussians that are gone.
    pub(super) fn forget_values(&mut self) {
        (self.labels, self.gathered) = (None, None);
    }
}

/// All that a training has learned and measured.
#[derive(Debug)]
pub(super) struct DeviceState {
    /// Parameters and moments.
    pub(super) model: ModelBuffers,
    /// Sum of absgrad and steps on screen, by Gaussian.
    pub(super) density: Buffer<[f32; 2]>,
    pub(super) measured: Measured,
}

impl DeviceState {
    /// A host's state in device memory.
    pub(super) fn upload(gpu: &Gpu, state: &TrainState) -> Result<Self, DeviceError> {
        let model = ModelBuffers::upload(gpu, &state.model)?;
        for (buffer, moments) in
            [&model.first, &model.second].into_iter().zip([&state.moments.first, &state.moments.second])
        {
            gpu.write(buffer, 0, &planar(moments));
        }
        for (buffer, moments) in
            [&model.globals_first, &model.globals_second].into_iter().zip(&state.moments.globals)
        {
            gpu.write(buffer, 0, moments.as_flattened());
        }
        let stats = state.density.absgrad.iter().zip(&state.density.seen);
        let stats: Vec<[f32; 2]> = stats.map(|(sum, seen)| [*sum, *seen]).collect();
        let some = |data: &[f32], label: &str| {
            if data.is_empty() { Ok(None) } else { gpu.upload(label, data).map(Some) }
        };
        let measured = Measured {
            labels: some(&state.labels, "probe labels")?,
            gathered: some(state.gathered.as_flattened(), "gathered light")?,
            ever: !state.labels.is_empty(),
        };
        Ok(Self { model, density: gpu.upload("density statistics", &stats)?, measured })
    }

    /// The state on the host; `shape` gives all of the model but its parameters.
    pub(super) fn download(&self, gpu: &Gpu, shape: &Model) -> Result<TrainState, DeviceError> {
        let buffers = &self.model;
        let gaussians = |buffer| buffers.read_gaussians(gpu, buffer, &shape.gaussians);
        let globals = |buffer| -> Result<Vec<[f32; 3]>, DeviceError> {
            Ok(buffers.read_globals(gpu, buffer)?.concat())
        };
        let read = |buffer: &Option<Buffer<f32>>| match buffer {
            Some(buffer) => gpu.read(buffer, 0..buffer.len()),
            None => Ok(Vec::new()),
        };
        let mut model = shape.clone();
        model.gaussians = gaussians(&buffers.params)?;
        [model.prototypes, model.env_raw] = buffers.read_globals(gpu, &buffers.globals)?;
        Ok(TrainState {
            arriving: Vec::new(),
            model,
            moments: Moments {
                first: gaussians(&buffers.first)?,
                second: gaussians(&buffers.second)?,
                globals: [globals(&buffers.globals_first)?, globals(&buffers.globals_second)?],
            },
            density: read_stats(gpu, &self.density)?,
            labels: read(&self.measured.labels)?,
            gathered: read(&self.measured.gathered)?.as_chunks::<6>().0.to_vec(),
        })
    }

    /// The same state in memory of its own.
    pub(super) fn copied(&self, gpu: &Gpu) -> Result<Self, DeviceError> {
        let mut recorder = gpu.record();
        let mut copy = |buffer: &Buffer<f32>| -> Result<Buffer<f32>, DeviceError> {
            let out = gpu.buffer("copied state", buffer.len())?;
            recorder.copy(buffer, 0, &out, 0, buffer.len());
            Ok(out)
        };
        let model = ModelBuffers {
            params: copy(&self.model.params)?,
            first: copy(&self.model.first)?,
            second: copy(&self.model.second)?,
            globals: copy(&self.model.globals)?,
            globals_first: copy(&self.model.globals_first)?,
            globals_second: copy(&self.model.globals_second)?,
            ..self.model.clone()
        };
        let density = copy(&self.density.cast())?.cast();
        let measured = Measured {
            labels: self.measured.labels.as_ref().map(&mut copy).transpose()?,
            gathered: self.measured.gathered.as_ref().map(&mut copy).transpose()?,
            ever: self.measured.ever,
        };
        recorder.submit()?;
        Ok(Self { model, density, measured })
    }

    /// The model as frames read it, under the light of the training.
    pub(super) fn source(&self, light: &TrainingLight) -> AttributeSource {
        AttributeSource {
            gathered: self.measured.gathered.clone(),
            indirect_basis: Some(light.light.indirect_basis.clone()),
            ..AttributeSource::new(&self.model)
        }
    }
}
