//! State of a training in device memory.

use crate::gpu::density::{UploadedPlan, inherit, read_stats};
use crate::gpu::gather::GATHERED;
use crate::gpu::light::TrainingLight;
use crate::gpu::model::{ModelBuffers, planar};
use crate::gpu::{AttributeSource, Buffer, Gpu, Recorder};
use crate::{DeviceError, Moments, PhotoLight, TrainState};
use relume_scene::{IndirectForm, MAX_LIGHTS, Model};

/// Measured data, which is not learned.
#[derive(Debug, Clone)]
pub(super) struct MeasuredBuffers {
    /// Probe labels, `[Gaussian][coefficient]`.
    pub(super) labels: Option<Buffer<f32>>,
    /// Gathered light per rotation of the light, each with the arriving shares of the model's lights, as in
    /// [`AttributeSource::gathered`].
    pub(super) gathered: Vec<Buffer<f32>>,
    /// True after the first measurement, also after its Gaussians have been replaced.
    pub(super) ever: bool,
}

impl MeasuredBuffers {
    /// Gives the Gaussians of the next generation the measurements of their sources among `before` Gaussians.
    pub(super) fn inherit(
        &mut self,
        recorder: &mut Recorder<'_>,
        before: usize,
        plan: &UploadedPlan,
    ) -> Result<(), DeviceError> {
        if let Some(labels) = &mut self.labels {
            *labels = inherit(recorder, labels, &[labels.len() / before.max(1)], plan)?;
        }
        for block in &mut self.gathered {
            let arriving = block.len() / before.max(1) - GATHERED;
            let widths = [GATHERED, arriving];
            *block = inherit(recorder, block, if arriving == 0 { &widths[..1] } else { &widths }, plan)?;
        }
        Ok(())
    }
}

/// Measured light of a host's state per rotation of the light, each in the order of the device's buffer.
fn measured_light(state: &TrainState) -> Vec<Vec<f32>> {
    let floats = GATHERED * state.model.gaussians.len();
    let mut blocks: Vec<Vec<f32>> =
        state.gathered.as_flattened().chunks(floats.max(1)).map(<[f32]>::to_vec).collect();
    if !state.arriving.is_empty() {
        if blocks.is_empty() {
            blocks.push(vec![0.0; floats]);
        }
        blocks.iter_mut().for_each(|block| block.extend(state.arriving.as_flattened()));
    }
    blocks
}

/// State of a training: everything that it has learned and measured.
#[derive(Debug)]
pub(super) struct DeviceState {
    /// Parameters and moments.
    pub(super) model: ModelBuffers,
    /// Sum of absgrad and number of steps on screen, per Gaussian.
    pub(super) density: Buffer<[f32; 2]>,
    pub(super) measured: MeasuredBuffers,
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
        let measured = measured_light(state);
        let measured = MeasuredBuffers {
            labels: some(&state.labels, "probe labels")?,
            gathered: measured
                .iter()
                .map(|block| gpu.upload("gathered light", block))
                .collect::<Result<_, _>>()?,
            ever: !state.labels.is_empty(),
        };
        Ok(Self { model, density: gpu.upload("density statistics", &stats)?, measured })
    }

    /// The state on the host; `shape` gives everything of the model except its parameters.
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
        let (mut gathered, mut arriving) = (Vec::new(), Vec::new());
        for block in &self.measured.gathered {
            let mut light = gpu.read(block, 0..block.len())?;
            arriving = light.split_off(light.len().min(GATHERED * buffers.len()));
            gathered.extend(light);
        }
        // For models without gathered light, the zeros before the arriving shares are no measurement.
        let gathers = shape.shading.indirect == IndirectForm::Gathered;
        Ok(TrainState {
            arriving: arriving.as_chunks::<MAX_LIGHTS>().0.to_vec(),
            model,
            moments: Moments {
                first: gaussians(&buffers.first)?,
                second: gaussians(&buffers.second)?,
                globals: [globals(&buffers.globals_first)?, globals(&buffers.globals_second)?],
            },
            density: read_stats(gpu, &self.density)?,
            labels: read(&self.measured.labels)?,
            gathered: if gathers { gathered.as_chunks::<GATHERED>().0.to_vec() } else { Vec::new() },
        })
    }

    /// A copy of the state.
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
        let measured = MeasuredBuffers {
            labels: self.measured.labels.as_ref().map(&mut copy).transpose()?,
            gathered: self.measured.gathered.iter().map(&mut copy).collect::<Result<_, _>>()?,
            ever: self.measured.ever,
        };
        recorder.submit()?;
        Ok(Self { model, density, measured })
    }

    /// Drops the arriving shares of replaced lights.
    pub(super) fn forget_arriving(&mut self, gpu: &Gpu) -> Result<(), DeviceError> {
        let floats = GATHERED * self.model.len();
        let mut recorder = gpu.record();
        for measured in self.measured.gathered.iter_mut().filter(|g| g.len() > floats) {
            let gathered = gpu.buffer("gathered light", floats)?;
            recorder.copy(measured, 0, &gathered, 0, floats);
            *measured = gathered;
        }
        recorder.submit().map(drop)
    }

    /// The model as input of frames, under the light of a photograph.
    pub(super) fn source(&self, light: &TrainingLight, of_photo: PhotoLight) -> AttributeSource {
        AttributeSource {
            gathered: self.measured.gathered.get(of_photo.block).cloned(),
            indirect_basis: Some(light.light.indirect_basis.clone()),
            ..AttributeSource::new(&self.model)
        }
    }
}
