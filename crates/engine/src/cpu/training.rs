//! Training on the CPU engine: objective, gradients, Adam, measured visibility.

use std::borrow::Cow;
use std::sync::Arc;

use crate::cpu::adam::adam_step;
use crate::cpu::objective::image::Target;
use crate::cpu::objective::{aggregation, geometry, parameters};
use crate::cpu::{
    AttributeSource, BranchImages, BufferGradient, Pass, Probes, SkyShadows, SurfaceShader, Transport,
    arriving, density, outward_normals, radiance_image, radiance_image_backward,
};
use crate::density::{DensityPlan, DensitySignals};
use crate::step::{FieldUpdate, PhotoId, ProbeMeasurement, Step, StepResult};
use crate::{
    DeviceError, Gradients, NO_INDIRECT_BASIS, PhotoLight, ProbeSettings, RasterCamera, StepWeights,
    TrainState, TurnedLight, fibonacci_sphere, indirect_basis, training,
};
use relume_layout::constants::EarlyStop;
use relume_scene::light::{EnvOperators, LightTables};
use relume_scene::{ColumnShift, Field, IndirectForm, Model, VisibilityForm, softplus, texel_directions};

/// Runs a stage of a step in a span, which a profile measures.
macro_rules! stage {
    ($name:literal, $work:expr) => {{
        let _span = tracing::debug_span!($name).entered();
        $work
    }};
}

/// The state with the operators of its light, and the snapshot of both for a roll-back.
pub struct CpuTraining {
    state: TrainState,
    operators: Arc<EnvOperators>,
    snapshot: (TrainState, Arc<EnvOperators>),
}

/// Value and gradients of the objective.
pub struct ObjectiveResult {
    /// The objective.
    pub loss: f32,
    /// Mean squared error of the leading branch.
    pub mse: f32,
    /// Gradient by every parameter.
    pub gradients: Gradients,
}

/// The kernel input of a state.
pub(crate) fn source<'a>(
    state: &'a TrainState,
    basis: &'a [[f32; 3]; 16],
    light: PhotoLight,
) -> AttributeSource<'a> {
    let Model { gaussians, prototypes, shading, .. } = &state.model;
    AttributeSource {
        gathered: state.gathered_in(light.block),
        arriving: &state.arriving,
        indirect_basis: basis,
        ..AttributeSource::new(gaussians, prototypes, shading)
    }
}

/// Radiance of the environment texels of light group `group`, without rotation.
pub(crate) fn environment_radiance(model: &Model, group: usize) -> Vec<[f32; 3]> {
    model.env_raw_of(group).iter().map(|t| t.map(softplus)).collect()
}

/// The tables of one of the model's lights.
pub(crate) fn tables_of(model: &Model, operators: &EnvOperators, light: TurnedLight) -> LightTables {
    let turn = ColumnShift::new(light.radians, model.env_width);
    operators.apply(&turn.apply(&environment_radiance(model, light.group)))
}

impl CpuTraining {
    /// Starts a training from `state`.
    pub fn new(state: TrainState, operators: &Arc<EnvOperators>) -> Self {
        Self { snapshot: (state.clone(), operators.clone()), state, operators: operators.clone() }
    }
}

impl training::TrainingEngine for CpuTraining {
    fn step(&mut self, step: &Step<'_>) -> Result<Option<StepResult>, DeviceError> {
        let outcome = objective(step, &self.state, &self.operators);
        let _span = tracing::debug_span!("adam").entered();
        let finite = outcome.loss.is_finite() && outcome.gradients.is_finite();
        if finite {
            let TrainState { model, moments, density, .. } = &mut self.state;
            density.record(&outcome.gradients);
            adam_step(model, moments, &outcome.gradients, &step.sizes, step.counts);
        }
        Ok(Some(StepResult { loss: outcome.loss, mse: outcome.mse, finite }))
    }

    fn holds(&self, _: PhotoId) -> bool {
        false
    }

    fn finish(&mut self) -> Result<Option<StepResult>, DeviceError> {
        Ok(None)
    }

    fn measure(&mut self, how: &ProbeMeasurement<'_>) -> Result<(), DeviceError> {
        measure(&mut self.state, &self.operators, how);
        Ok(())
    }

    fn density_signals(&self) -> Result<DensitySignals, DeviceError> {
        Ok(density::signals(&self.state))
    }

    fn rebuild(&mut self, plan: &DensityPlan) -> Result<(), DeviceError> {
        density::rebuild(&mut self.state, plan);
        Ok(())
    }

    fn load(&mut self, state: TrainState) -> Result<(), DeviceError> {
        self.state = state;
        Ok(())
    }

    fn reshape(&mut self, state: TrainState, operators: &Arc<EnvOperators>) -> Result<(), DeviceError> {
        self.operators = operators.clone();
        self.snapshot = (state.clone(), operators.clone());
        self.state = state;
        Ok(())
    }

    fn light(&mut self, operators: &Arc<EnvOperators>) -> Result<(), DeviceError> {
        self.operators = operators.clone();
        self.state.model.lights = operators.split().clone();
        self.state.arriving = Vec::new();
        Ok(())
    }

    fn snapshot(&mut self) -> Result<bool, DeviceError> {
        let finite = self.state.model.gaussians.is_finite();
        if finite {
            self.snapshot = (self.state.clone(), self.operators.clone());
        }
        Ok(finite)
    }

    fn roll_back(&mut self) -> Result<(), DeviceError> {
        (self.state, self.operators) = self.snapshot.clone();
        Ok(())
    }

    fn gaussians(&self) -> usize {
        self.state.model.gaussians.len()
    }

    fn state(&self) -> Result<Cow<'_, TrainState>, DeviceError> {
        Ok(Cow::Borrowed(&self.state))
    }

    fn engine(&self) -> &'static str {
        "cpu"
    }
}

/// The objective of `step` (docs/MODEL.md section 5) and its gradients; `operators` belong to the state's light.
pub fn objective(step: &Step<'_>, state: &TrainState, operators: &EnvOperators) -> ObjectiveResult {
    match step.branches.is_physical() {
        true => both_branches(step, state, operators),
        false => radiance_branch(step, state),
    }
}

/// The objective of the radiance branch and the geometry.
fn radiance_branch(step: &Step<'_>, state: &TrainState) -> ObjectiveResult {
    let (photo, w) = (step.photo, &step.weights);
    let source = source(state, &NO_INDIRECT_BASIS, photo.light);
    let channels = step.branches.channels(source.gaussians, source.options).differentiated;
    let view = RasterCamera::new(&photo.camera, source.options);
    let pass = stage!("forward", Pass::forward(&source, view, channels, EarlyStop::WhenSaturated));
    let image = stage!("shade", radiance_image(&pass, step.background));
    let compare = tracing::debug_span!("compare").entered();
    let target = Target::new(view.width, view.height, &photo.pixels);
    let fit = target.compare(&image, w.radiance);
    drop(compare);
    let mut by_buffers = vec![BufferGradient::default(); image.len()];
    let mut loss = fit.value(w.radiance);
    loss += stage!("surface_terms", surface_terms(step, &pass, &mut by_buffers));
    let count = channels.count();
    let by_gbuffer = stage!(
        "shade_backward",
        radiance_image_backward(&pass, step.background, &fit.gradient, &by_buffers, count)
    );
    let _backward = tracing::debug_span!("backward").entered();
    let mut gradients = pass.backward(&source, &by_gbuffer, count.next_multiple_of(4), count, None);
    gradients.env_raw = vec![[0.0; 3]; state.model.env_raw.len()];
    loss += parameters::flatness(source.gaussians, w.parameters.flatness, &mut gradients);
    ObjectiveResult { loss, mse: fit.mse, gradients }
}

/// The whole objective (Eq. 29 and additions).
fn both_branches(step: &Step<'_>, state: &TrainState, operators: &EnvOperators) -> ObjectiveResult {
    let (photo, w, model) = (step.photo, &step.weights, &state.model);
    let PhotoLight { light: TurnedLight { group, radians }, .. } = photo.light;
    let radiance = environment_radiance(model, group);
    let turn = ColumnShift::new(radians, model.env_width);
    let tables = stage!("light_tables", operators.apply(&turn.apply(&radiance)));
    let basis = indirect_basis(&tables);
    let sh_degree = model.gaussians.visibility_degree();
    let shader = SurfaceShader { tables: &tables, options: &model.shading, sh_degree, range: photo.range };
    let source = source(state, &basis, photo.light).under(shader);
    let view = RasterCamera::new(&photo.camera, source.options);
    let channels = step.branches.channels(&model.gaussians, &model.shading);
    let pass = stage!("forward", Pass::forward(&source, view, channels.blended, EarlyStop::WhenSaturated));
    let images = stage!("shade", shader.images(&pass, step.background));
    let compare = tracing::debug_span!("compare").entered();
    let target = Target::new(view.width, view.height, &photo.pixels);
    let (physical, plain) = rayon::join(
        || target.compare(&images.physical, w.physical),
        || target.compare(&images.radiance, w.radiance),
    );
    drop(compare);
    let mut loss = physical.value(w.physical) + plain.value(w.radiance);
    let mut by_buffers = vec![BufferGradient::default(); photo.pixels.len()];
    loss += stage!("surface_terms", surface_terms(step, &pass, &mut by_buffers));
    let by_images = BranchImages { physical: physical.gradient, radiance: plain.gradient };
    let count = channels.differentiated.count();
    let (by_gbuffer, mut by_tables) = stage!(
        "shade_backward",
        shader.images_backward(&pass, step.background, &by_images, &by_buffers, count)
    );
    let mut gradients = stage!(
        "backward",
        pass.backward(&source, &by_gbuffer, count.next_multiple_of(4), count, Some(&mut by_tables))
    );
    let by_turned = stage!("light_tables", operators.apply_transposed(&by_tables));
    let mut by_radiance = turn.apply_transposed(&by_turned).into_owned();
    loss += light_terms(step, model, &radiance, &mut by_radiance);
    gradients.env_raw = vec![[0.0; 3]; model.env_raw.len()];
    let by_raw = gradients.env_raw.iter_mut().zip(&model.env_raw).skip(group * model.env_texels());
    for ((by_raw, raw), g) in by_raw.zip(&by_radiance) {
        *by_raw = std::array::from_fn(|c| g[c] / (1.0 + (-raw[c]).exp()));
    }
    loss += stage!("parameter_terms", parameter_terms(w, &source, &pass, &state.labels, &mut gradients));
    ObjectiveResult { loss, mse: physical.mse, gradients }
}

/// Terms on the G-buffer: adds their gradients, returns their value.
fn surface_terms(step: &Step<'_>, pass: &Pass, by_buffers: &mut [BufferGradient]) -> f32 {
    let w = &step.weights.surface;
    let mut loss = 0.0;
    if w.coverage != 0.0 {
        loss += geometry::coverage(pass, &step.photo.alpha, w.coverage, by_buffers);
    }
    loss += geometry::depth_normal(pass, w.depth_normal, by_buffers);
    loss + geometry::smoothness(pass, &step.photo.pixels, w.smoothness, by_buffers)
}

/// Terms on the light: adds their gradients by radiance, returns their value.
fn light_terms(step: &Step<'_>, model: &Model, radiance: &[[f32; 3]], by_radiance: &mut [[f32; 3]]) -> f32 {
    let w = &step.weights.light;
    let texels = texel_directions(model.env_width, model.env_height);
    let terms = [
        parameters::light_neutrality(radiance, w.neutrality),
        parameters::exposure(radiance, &texels, w.exposure),
        parameters::light_colour(radiance, &texels, w),
    ];
    for (_, by_term) in &terms {
        by_radiance.iter_mut().zip(by_term).for_each(|(g, term)| (0..3).for_each(|c| g[c] += term[c]));
    }
    terms.iter().map(|(value, _)| value).sum()
}

/// Terms on the parameters: adds their gradients, returns their value.
fn parameter_terms(
    weights: &StepWeights,
    source: &AttributeSource<'_>,
    pass: &Pass,
    labels: &[f32],
    gradients: &mut Gradients,
) -> f32 {
    let (w, g, form) = (&weights.parameters, source.gaussians, source.options.visibility);
    let mut loss = aggregation::aggregation(g, w.aggregation, gradients);
    loss += parameters::residual(g, w.residual, gradients);
    loss += parameters::flatness(g, w.flatness, gradients);
    if form != VisibilityForm::Off && w.view_labels != 0.0 {
        loss += parameters::backward_labels(g, pass, form, w.view_labels, gradients);
    }
    if form != VisibilityForm::Off && w.probe_labels != 0.0 {
        loss += parameters::probe_labels(g, labels, w.probe_labels, gradients);
    }
    loss
}

/// Light that the Gaussians gather through `probes` under each of `tables`, with the shadows of the sky. `outward`: outward normals of the
/// measurement.
fn gathered(
    state: &TrainState,
    probes: &Probes,
    outward: Vec<[f32; 3]>,
    tables: &[LightTables],
    bounces: usize,
) -> Vec<[f32; 6]> {
    let source = source(state, &NO_INDIRECT_BASIS, PhotoLight::default());
    let sky = source.options.has_sky_shadows().then(|| SkyShadows::new(&source, probes, &outward));
    let transport = Transport::new(probes, outward);
    let under = |tables: &LightTables| {
        let gathered = transport.gather(&source, tables, bounces);
        match &sky {
            Some(sky) => sky.added_to(gathered, &source, tables),
            None => gathered,
        }
    };
    tables.iter().flat_map(under).collect()
}

/// Measures visibility and gathers light again (docs/MODEL.md, section 6).
fn measure(state: &mut TrainState, operators: &EnvOperators, how: &ProbeMeasurement<'_>) {
    let gathers = how.bounces > 0 && state.model.shading.indirect == IndirectForm::Gathered;
    if state.model.shading.visibility == VisibilityForm::Off && !gathers {
        return;
    }
    let tables = |light: &TurnedLight| tables_of(&state.model, operators, *light);
    let tables: Vec<LightTables> = if gathers { how.lights.iter().map(tables).collect() } else { Vec::new() };
    let sh_degree = state.model.gaussians.visibility_degree();
    for _ in 0..how.repeats {
        let source = source(state, &NO_INDIRECT_BASIS, PhotoLight::default());
        let directions = fibonacci_sphere(how.directions);
        let probes = Probes::measure(&source, directions, ProbeSettings::of(source.options));
        let (outward, arriving) = (outward_normals(&source), arriving(&source, &operators.split().lights));
        let labels = probes.coefficients(sh_degree);
        let replaces = match how.field {
            FieldUpdate::Replace => true,
            FieldUpdate::Start => state.labels.is_empty(),
            FieldUpdate::Keep => false,
        };
        if replaces {
            state.model.gaussians.field_mut(Field::Visibility).copy_from_slice(&labels);
        }
        (state.labels, state.arriving) = (labels, arriving);
        if gathers {
            state.gathered = gathered(state, &probes, outward, &tables, how.bounces);
        }
    }
}
