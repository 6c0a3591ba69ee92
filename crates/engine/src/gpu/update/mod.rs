//! Parameter update of a step on the device: from the summed gradients of the splats to new parameters.
//!
//! For every Gaussian, `shaders/update.wgsl` computes the chain rules of projection and attributes (docs/MODEL.md, sections 1
//! to 3), adds the terms of the objective on the parameters themselves (section 5) and runs Adam.
//! `shaders/adam_globals.wgsl` does the same for prototypes and light.

use bytemuck::{Pod, Zeroable};

use crate::adam::{FieldGroup, HIGHER_DEGREE_SHARE};
use crate::gpu::model::ModelBuffers;
use crate::gpu::raster::{Differentiated, SplatRecord};
use crate::gpu::{Buffer, CameraUniform, Gpu, Groups, Recorder, shaders, uniform};
use crate::{DeviceError, ParameterWeights, StepCounts, StepSizes};
use relume_scene::Field;

pub use relume_layout::kernel_constants::STATUS_WORDS;

/// Slot of `UpdateUniform::rates` for radiance coefficients above degree 0.
const RADIANCE_REST: usize = Field::COUNT;
/// Number of slots of `UpdateUniform::rates`.
const RATES: usize = Field::COUNT + 1;

/// `Update` of `shaders/update.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct UpdateUniform {
    rates: [[f32; 4]; RATES],
    groups: u32,
    half_width: f32,
    aggregation: f32,
    residual: f32,
    flatness: f32,
    probe_labels: f32,
    view_labels: f32,
    pad: u32,
}

/// `AdamGlobals` of `shaders/adam_globals.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct AdamGlobals {
    n_prototypes: u32,
    n: u32,
    rate_prototypes: f32,
    rate_environment: f32,
    correction: f32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
}

/// `LabelCount` of `shaders/label_count.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct LabelCount {
    n: u32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
}

/// Gradients from the backward pass through the image, and the labels.
#[derive(Debug, Clone, Copy)]
pub struct UpstreamGradients<'a> {
    /// The camera.
    pub camera: &'a CameraUniform,
    /// The splat of each Gaussian.
    pub splats: &'a Buffer<SplatRecord>,
    /// Summed gradients per Gaussian, `8 + 4 groups` floats; rows of invisible splats are not read.
    pub gradients: &'a Buffer<f32>,
    /// Number of differentiated groups of four channels: 1 (colour), 2 (geometry), 4 (material) or all.
    pub groups: usize,
    /// `E_j` of Eq. 20 and the buffer to which its gradient is added, both `[16][3]`; only for `IndirectForm::Learned`.
    pub indirect_basis: Option<(&'a Buffer<f32>, &'a Buffer<f32>)>,
    /// Measured visibility, `[Gaussian][coefficient]`.
    pub probe_labels: Option<&'a Buffer<f32>>,
    /// Backward labels per Gaussian: `sum w That, sum w`; zero without a label.
    pub view_labels: Option<&'a Buffer<[f32; 2]>>,
}

impl<'a> UpstreamGradients<'a> {
    /// The gradients of `frame`, without labels and learned indirect light.
    pub fn new(frame: &'a Differentiated<'_>) -> Self {
        let projected = &frame.blended.attributed.projected;
        Self {
            camera: &projected.camera,
            splats: &projected.splats,
            gradients: &frame.splat_gradients,
            groups: frame.groups,
            indirect_basis: None,
            probe_labels: None,
            view_labels: None,
        }
    }
}

/// Sums to which the update adds; the caller clears them.
#[derive(Debug, Clone, Copy)]
pub struct UpdateSums<'a> {
    /// Gradient of prototypes and raw environment, laid out as `ModelBuffers::globals`; the update adds the prototypes' part.
    pub globals_gradient: &'a Buffer<f32>,
    /// 16 values, the slots of [`LossSlot`](relume_layout::kernel_constants::LossSlot).
    pub losses: &'a Buffer<f32>,
    /// Per Gaussian: sum of absgrad in half image widths, steps on screen.
    pub density: &'a Buffer<[f32; 2]>,
    /// Status of the step's tile lists ([`Projected::list_status`](crate::gpu::raster::Projected::list_status)); if they were too
    /// short, nothing is updated.
    pub list_status: &'a Buffer<u32>,
    /// Element 0 becomes non-zero when a gradient is not finite: the update leaves the parameters of that
    /// gradient unchanged, and the step must be rolled back.
    pub status: &'a Buffer<u32>,
}

/// Inputs and outputs of an update of the Gaussians.
#[derive(Debug, Clone, Copy)]
pub struct StepInput<'a> {
    /// Parameters and moments.
    pub model: &'a ModelBuffers,
    /// Gradients of the image, and labels.
    pub upstream: UpstreamGradients<'a>,
    /// Sums to which the update adds.
    pub sums: UpdateSums<'a>,
    /// Weights of the terms on the parameters.
    pub weights: ParameterWeights,
}

/// The update kernels with their small buffers.
#[derive(Debug, Clone)]
pub struct Updater {
    label_count: Buffer<u32>,
    /// Bound in place of missing inputs: one buffer for read-only bindings, one for read-write bindings.
    unread: Buffer<f32>,
    unwritten: Buffer<f32>,
}

impl Updater {
    /// # Errors
    /// When the device has no memory left.
    pub fn new(gpu: &Gpu) -> Result<Self, DeviceError> {
        Ok(Self {
            label_count: gpu.buffer("label count", 1)?,
            unread: gpu.buffer("nothing to read", 64)?,
            unwritten: gpu.buffer("nothing to write", 64)?,
        })
    }

    /// One Adam step of all Gaussians, on screen or not.
    pub fn step(
        &self,
        recorder: &mut Recorder<'_>,
        input: &StepInput<'_>,
        sizes: &StepSizes,
        counts: StepCounts,
    ) {
        let uniforms = self.uniforms(recorder, input, rate_table(sizes, counts));
        let model = input.model;
        self.dispatch(recorder, &shaders::UPDATE, &uniforms, input, &[&model.first, &model.second]);
        // Parameters and both moments read and written, the gradient row read; about 20 operations per element.
        let (floats, row) = (model.layout.floats() as u64, 8 + 4 * input.upstream.groups as u64);
        recorder.work(24 * floats + model.len() as u64 * (64 + 4 * row), 20 * floats);
    }

    /// Writes the gradient of every parameter to `out`, laid out as the parameters, instead of an Adam step.
    pub fn gradients(&self, recorder: &mut Recorder<'_>, input: &StepInput<'_>, out: &Buffer<f32>) {
        let uniforms = self.uniforms(recorder, input, [[0.0; 4]; RATES]);
        self.dispatch(recorder, &shaders::UPDATE_GRADIENTS, &uniforms, input, &[out]);
    }

    /// One Adam step of prototypes and environment from their complete gradient.
    pub fn step_globals(
        &self,
        recorder: &mut Recorder<'_>,
        model: &ModelBuffers,
        sums: &UpdateSums<'_>,
        sizes: &StepSizes,
        counts: StepCounts,
    ) {
        let [first, second] = counts.corrections(FieldGroup::Material);
        let n = 3 * (model.n_prototypes + model.n_texels);
        let uniforms = AdamGlobals {
            n_prototypes: 3 * model.n_prototypes as u32,
            n: n as u32,
            rate_prototypes: sizes.prototypes / first,
            rate_environment: sizes.environment / first,
            correction: second,
            pad_0: 0,
            pad_1: 0,
            pad_2: 0,
        };
        let bindings = [
            uniform(&uniforms),
            sums.globals_gradient.into(),
            (&model.globals).into(),
            (&model.globals_first).into(),
            (&model.globals_second).into(),
            sums.status.into(),
            sums.list_status.into(),
        ];
        recorder.stage("update");
        recorder.dispatch(&shaders::ADAM_GLOBALS, Groups::Linear(n), &bindings);
    }

    /// The uniform of a step; counts the view's labels first where they have a weight.
    fn uniforms(
        &self,
        recorder: &mut Recorder<'_>,
        input: &StepInput<'_>,
        rates: [[f32; 4]; RATES],
    ) -> UpdateUniform {
        let StepInput { model, upstream, weights, .. } = input;
        let has_views = upstream.view_labels.filter(|_| weights.view_labels != 0.0);
        if let Some(labels) = has_views {
            recorder.stage("labels");
            recorder.clear(&self.label_count);
            let uniforms = LabelCount { n: model.layout.n, pad_0: 0, pad_1: 0, pad_2: 0 };
            let bindings = [uniform(&uniforms), labels.into(), (&self.label_count).into()];
            recorder.dispatch(&shaders::LABEL_COUNT, Groups::Linear(model.len()), &bindings);
        }
        let n = model.len().max(1) as f32;
        let on = |is_on: bool, weight: f32| if is_on { weight } else { 0.0 };
        UpdateUniform {
            rates,
            groups: upstream.groups as u32,
            half_width: 0.5 * upstream.camera.size[0].max(upstream.camera.size[1]) as f32,
            aggregation: weights.aggregation / n,
            residual: weights.residual / n,
            flatness: weights.flatness / n,
            probe_labels: on(upstream.probe_labels.is_some(), weights.probe_labels)
                / (n * 4.0 * std::f32::consts::PI),
            view_labels: on(has_views.is_some(), weights.view_labels),
            pad: 0,
        }
    }

    fn dispatch(
        &self,
        recorder: &mut Recorder<'_>,
        kernel: &'static shaders::Kernel,
        uniforms: &UpdateUniform,
        input: &StepInput<'_>,
        outputs: &[&Buffer<f32>],
    ) {
        let StepInput { model, upstream, sums, .. } = input;
        let (basis, by_basis) = upstream.indirect_basis.unwrap_or((&self.unread, &self.unwritten));
        let unread = self.unread.cast();
        let mut bindings = vec![
            uniform(&model.layout),
            uniform(upstream.camera),
            uniform(uniforms),
            upstream.splats.into(),
            upstream.gradients.into(),
            (&model.globals).into(),
            sums.globals_gradient.into(),
            basis.into(),
            by_basis.into(),
            upstream.probe_labels.unwrap_or(&self.unread).into(),
            upstream.view_labels.unwrap_or(&unread).into(),
            (&self.label_count).into(),
            sums.losses.into(),
            sums.density.into(),
            sums.status.into(),
            sums.list_status.into(),
            (&model.params).into(),
        ];
        bindings.extend(outputs.iter().map(|b| (*b).into()));
        recorder.stage("update");
        let (floats, row) = (model.layout.floats() as u64, 8 + 4 * upstream.groups as u64);
        // Parameters and two moments read and written, or parameters read and gradients written; splats and their gradients read.
        let passes = 2 * outputs.len() as u64 + u64::from(outputs.len() > 1) * 2;
        recorder.work(4 * (passes * floats + model.len() as u64 * (16 + row)), 12 * floats);
        recorder.dispatch(kernel, Groups::Linear(model.len()), &bindings);
    }
}

/// `UpdateUniform::rates`.
fn rate_table(sizes: &StepSizes, counts: StepCounts) -> [[f32; 4]; RATES] {
    let mut out = [[0.0; 4]; RATES];
    for field in Field::ALL {
        let [first, second] = counts.corrections(FieldGroup::of(field));
        out[field as usize] = [sizes.fields[field as usize] / first, second, 0.0, 0.0];
    }
    let [rate, second, ..] = out[Field::Radiance as usize];
    out[RADIANCE_REST] = [rate * HIGHER_DEGREE_SHARE, second, 0.0, 0.0];
    out
}

#[cfg(test)]
mod tests;
