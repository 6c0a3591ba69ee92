//! Steps of a training: recording, submission, and handling of their results.

use crate::gpu::frame::{FrameBranches, FrameGradients, FramePass};
use crate::gpu::objective::{LOSS_SLOTS, LossSlot, objective};
use crate::gpu::raster::Differentiated;
use crate::gpu::shading::Shading;
use crate::gpu::training::device_step::{DeviceStep, SubmittedStep};
use crate::gpu::training::image_buffers::ImageBuffers;
use crate::gpu::training::state::DeviceState;
use crate::gpu::training::{GpuTraining, STATUS_SLOT};
use crate::gpu::update::{StepInput, UpdateSums, Updater, UpstreamGradients};
use crate::gpu::{CameraUniform, Recorder};
use crate::{DeviceError, RasterCamera, Step, StepResult};
use relume_layout::constants::EarlyStop;
use relume_scene::{IndirectForm, Model, VisibilityForm};

impl GpuTraining {
    /// `step` with its photograph in device memory.
    pub(super) fn device_step(&mut self, step: &Step<'_>) -> Result<DeviceStep, DeviceError> {
        let shading = &self.shape.shading;
        Ok(DeviceStep {
            camera: CameraUniform::new(&RasterCamera::new(&step.photo.camera, shading)),
            photo: self.photos.upload(&self.gpu, step.photo_id, step.photo)?,
            light: step.photo.light,
            channels: step.branches.channels(&self.shape.gaussians, shading),
            background: step.background,
            branches: step.branches,
            weights: step.weights,
            sizes: step.sizes,
            counts: step.counts,
        })
    }

    /// Submits a step. If its tile lists are too short, neither it nor a later step changes the state until
    /// [`Self::finish_step`] has handled that.
    pub(super) fn submit(&mut self, step: DeviceStep) -> Result<SubmittedStep, DeviceError> {
        let gpu = self.gpu.clone();
        let pass = self.pass(&step);
        let image_buffers = ImageBuffers::at(&mut self.image_buffers, &gpu, step.camera.pixels())?;
        let source = self.state.source(&self.light, step.light);
        let mut recorder = gpu.record();
        recorder.clear(&self.losses);
        recorder.clear(&self.globals_gradient);
        recorder.clear(&self.status);
        let projected = self.raster.record(&mut recorder, &step.camera, &source)?;
        let list_status = projected.list_status().clone();
        if step.branches.is_physical() {
            let (turned, weights) = (step.light.light, &step.weights.light);
            self.light.apply(&mut recorder, &self.state.model, turned, weights, &self.losses);
        }
        let frame = pass.forward(&mut recorder, projected)?;
        pass.images(&mut recorder, &frame, &image_buffers.images)?;
        image_buffers.terms(&mut recorder, &step, step.channels.blended, &step.photo, &frame, &self.losses);
        let gradients = FrameGradients {
            by_images: &image_buffers.by_images,
            by_buffers: &image_buffers.by_buffers,
            by_tables: &self.light.tables_gradient,
            differentiated: step.channels.differentiated,
        };
        let frame = pass.backward(&mut recorder, frame, &gradients)?;
        let sums = UpdateSums {
            globals_gradient: &self.globals_gradient,
            losses: &self.losses,
            density: &self.state.density,
            list_status: &list_status,
            status: &self.status,
        };
        let (shape, state, updater) = (&self.shape, &self.state, &self.updater);
        let update = Update { shape, state, light: &self.light, updater, sums };
        update.record(&mut recorder, &step, frame)?;
        recorder.copy(&self.status.cast(), 0, &self.losses, STATUS_SLOT, 1);
        let losses = recorder.fetch(&self.losses, 0..LOSS_SLOTS);
        let list_status = recorder.fetch(&list_status, 0..list_status.len());
        Ok(SubmittedStep { step, submission: recorder.submit()?, losses, list_status })
    }

    /// Waits for a step and returns its result. If its tile lists were too short, it is submitted again with more memory, and
    /// so is the step after it, which changed nothing either.
    pub(super) fn finish_step(&mut self, mut pending: SubmittedStep) -> Result<StepResult, DeviceError> {
        loop {
            let arrival = pending.submission.wait_for_data()?;
            let (list_status, sums) = (arrival.read(&pending.list_status)?, arrival.read(&pending.losses)?);
            if self.raster.apply_list_status(&list_status)? {
                return Ok(step_sums(&pending.step, &sums));
            }
            pending = self.submit(pending.step)?;
            if let Some(behind) = self.pending.take() {
                self.pending = Some(self.submit(behind.step)?);
            }
        }
    }

    /// Settings of a step's frame.
    fn pass(&self, step: &DeviceStep) -> FramePass {
        let branches = match step.branches.is_physical() {
            false => FrameBranches::Radiance(step.background),
            true => FrameBranches::Both(Box::new(Shading {
                options: self.shape.shading,
                background: step.background,
                range: step.photo.range,
                light: self.light.light.clone(),
                constants: self.constants.clone(),
            })),
        };
        FramePass { channels: step.channels.blended, blending: EarlyStop::WhenSaturated, branches }
    }
}

/// Result of a step, from its sums and the status in their last slot.
fn step_sums(step: &DeviceStep, sums: &[f32]) -> StepResult {
    let poisoned = sums[STATUS_SLOT].to_bits() != 0;
    let loss = objective(sums, &step.weights);
    let physical = step.branches.is_physical();
    let leading = if physical { LossSlot::PhysicalSquared } else { LossSlot::RadianceSquared };
    StepResult { loss, mse: sums[leading as usize], finite: loss.is_finite() && !poisoned }
}

/// Inputs of the parameter update of a step.
struct Update<'a> {
    shape: &'a Model,
    state: &'a DeviceState,
    light: &'a crate::gpu::light::TrainingLight,
    updater: &'a Updater,
    sums: UpdateSums<'a>,
}

impl Update<'_> {
    /// Records the update of the parameters from the splats' gradients and, where the physically based branch trains, of
    /// prototypes and light.
    fn record(
        &self,
        recorder: &mut Recorder<'_>,
        step: &DeviceStep,
        mut frame: Differentiated<'_>,
    ) -> Result<(), DeviceError> {
        let (physical, sums) = (step.branches.is_physical(), self.sums);
        let mut weights = step.weights.parameters;
        if self.shape.shading.visibility == VisibilityForm::Off {
            (weights.probe_labels, weights.view_labels) = (0.0, 0.0);
        }
        let view_labels = match weights.view_labels {
            0.0 => None,
            _ => Some(frame.backward_labels(recorder)?),
        };
        let indirect = if physical { self.shape.shading.indirect } else { IndirectForm::Off };
        let basis = (&self.light.light.indirect_basis, &self.light.basis_gradient);
        let upstream = UpstreamGradients {
            indirect_basis: (indirect == IndirectForm::Learned).then_some(basis),
            probe_labels: self.state.measured.labels.as_ref(),
            view_labels: view_labels.as_ref(),
            ..UpstreamGradients::new(&frame)
        };
        let model = &self.state.model;
        let input = StepInput { model, upstream, sums, weights };
        self.updater.step(recorder, &input, &step.sizes, step.counts);
        if physical {
            let (turned, weights) = (step.light.light, &step.weights.light);
            self.light.backward(recorder, model, turned, weights, indirect, sums.globals_gradient);
            self.updater.step_globals(recorder, model, &sums, &step.sizes, step.counts);
        }
        Ok(())
    }
}
