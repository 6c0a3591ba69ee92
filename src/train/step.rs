//! The objective of one photograph and its gradients, and the refresh of what is measured rather than learned.

use crate::engine::Gradients;
use crate::engine::channel::{Channels, StepChannels};
use crate::engine::constants::EarlyStop;
use crate::engine::cpu::{
    self, AttributeSource, BufferGradient, Pass, ProbeSettings, Probes, SurfaceShader, Transport, View,
    fibonacci_sphere, outward_normals, radiance_image, radiance_image_backward,
};
use crate::light::EnvOperators;
use crate::scene::{Field, IndirectForm, Model, ShadeAt, VisibilityForm, softplus, texel_directions};
use crate::train::dataset::Photo;
use crate::train::objective::image::Target;
use crate::train::objective::{aggregation, geometry, material as terms};
use crate::train::state::Learned;
use crate::train::{LabelSource, TrainConfig};

/// Progress after which depth-normal consistency acts: before, depth is noise.
const GEOMETRY_FROM: f32 = 0.05;

/// What is the same for every step of a training.
#[derive(Debug, Clone, Copy)]
pub struct StepContext<'a> {
    /// The configuration.
    pub config: &'a TrainConfig,
    /// Operators of the training environment.
    pub operators: &'a EnvOperators,
    /// Display-referred background.
    pub background: [f32; 3],
    /// Whether masks mean something.
    pub has_alpha: bool,
    /// Share of the steps done.
    pub progress: f32,
}

/// Value and gradients of the objective.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// The objective.
    pub loss: f32,
    /// Mean squared error of the leading branch.
    pub mse: f32,
    /// Its gradients.
    pub gradients: Gradients,
}

/// What the engines read of a state.
pub(super) fn source<'a>(state: &'a Learned, basis: &'a [[f32; 3]; 16]) -> AttributeSource<'a> {
    let Model { gaussians, prototypes, shading, .. } = &state.model;
    AttributeSource {
        gaussians,
        prototypes,
        options: shading,
        gathered: &state.gathered,
        indirect_basis: basis,
        light: None,
    }
}

/// Radiance of the environment's texels.
pub(super) fn radiance_of(model: &Model) -> Vec<[f32; 3]> {
    model.env_raw.iter().map(|t| t.map(softplus)).collect()
}

/// Whether depth-normal consistency acts at this progress of the warm-up.
pub(super) fn is_shaped(config: &TrainConfig, progress: f32) -> bool {
    progress >= GEOMETRY_FROM && config.weights.depth_normal > 0.0
}

/// The objective during warm-up: radiance branch and geometry only.
pub fn radiance(context: &StepContext<'_>, state: &Learned, photo: &Photo) -> Outcome {
    let w = &context.config.weights;
    let basis = [[0.0; 3]; 16];
    let source = source(state, &basis);
    let view = View::new(&photo.camera, source.options);
    let shaped = is_shaped(context.config, context.progress);
    let channels = if shaped { Channels::Geometry } else { Channels::Colour };
    let pass = Pass::forward(&source, view, channels, EarlyStop::WhenSaturated);
    let image = radiance_image(&pass, context.background);
    let target = Target::new(view.width, view.height, photo.pixels.clone());
    let fit = target.compare(&image, w.l1, w.ssim);
    let mut by_buffers = vec![BufferGradient::default(); image.len()];
    let mut loss = w.l1 * fit.mae + w.ssim * (1.0 - fit.ssim);
    if context.has_alpha {
        loss += geometry::coverage(&pass, &photo.alpha, w.coverage, &mut by_buffers);
    }
    if shaped {
        loss += geometry::depth_normal(&pass, w.depth_normal, &mut by_buffers);
    }
    let count = channels.count();
    let by_gbuffer = radiance_image_backward(&pass, context.background, &fit.gradient, &by_buffers, count);
    let mut gradients = pass.backward(&source, &by_gbuffer, count.next_multiple_of(4), count, None);
    gradients.env_raw = vec![[0.0; 3]; state.model.env_raw.len()];
    loss += terms::flatness(source.gaussians, w.flatness, &mut gradients);
    Outcome { loss, mse: fit.mse, gradients }
}

/// The whole objective (Eq. 29 and additions).
pub fn material(context: &StepContext<'_>, state: &Learned, photo: &Photo) -> Outcome {
    let w = &context.config.weights;
    let radiance = radiance_of(&state.model);
    let tables = context.operators.apply(&radiance);
    let basis = cpu::indirect_basis(&tables);
    let Learned { model, .. } = state;
    let order = model.gaussians.visibility_order();
    let shader = SurfaceShader { tables: &tables, options: &model.shading, order };
    let source = source(state, &basis).under(shader);
    let view = View::new(&photo.camera, source.options);
    let StepChannels { blended, differentiated } = channels(context.config, model);
    let pass = Pass::forward(&source, view, blended, EarlyStop::WhenSaturated);
    let images = shader.images(&pass, context.background);
    let target = Target::new(view.width, view.height, photo.pixels.clone());
    let share = context.config.radiance_weight(context.has_alpha);
    let (physical, plain) = rayon::join(
        || target.compare(&images.physical, w.l1, w.ssim),
        || target.compare(&images.radiance, w.l1 * share, w.ssim * share),
    );
    let mut loss = w.l1 * physical.mae + w.ssim * (1.0 - physical.ssim);
    loss += share * (w.l1 * plain.mae + w.ssim * (1.0 - plain.ssim));
    let mut by_buffers = vec![BufferGradient::default(); photo.pixels.len()];
    if context.has_alpha {
        loss += geometry::coverage(&pass, &photo.alpha, w.coverage, &mut by_buffers);
    }
    loss += geometry::depth_normal(&pass, w.depth_normal, &mut by_buffers);
    loss += geometry::smoothness(&pass, &photo.pixels, w.smooth(), &mut by_buffers);
    let by_images = cpu::BranchImages { physical: physical.gradient, radiance: plain.gradient };
    let count = differentiated.count();
    let (by_gbuffer, mut by_tables) =
        shader.images_backward(&pass, context.background, &by_images, &by_buffers, count);
    let mut gradients =
        pass.backward(&source, &by_gbuffer, count.next_multiple_of(4), count, Some(&mut by_tables));
    let (neutral, by_neutral) = terms::light_neutrality(&radiance, w.light);
    let texels = texel_directions(state.model.env_width, state.model.env_height);
    let (level, by_level) = terms::exposure(&radiance, &texels, w.exposure);
    let daylight = context.config.daylight_weight(context.progress);
    let (colour, by_colour) = terms::daylight(&radiance, &texels, daylight);
    loss += neutral + level + colour;
    let mut by_radiance = context.operators.apply_transposed(&by_tables);
    for by_term in [by_neutral, by_level, by_colour] {
        by_radiance.iter_mut().zip(&by_term).for_each(|(g, term)| (0..3).for_each(|c| g[c] += term[c]));
    }
    gradients.env_raw = by_radiance
        .iter()
        .zip(&state.model.env_raw)
        .map(|(g, raw)| std::array::from_fn(|c| g[c] / (1.0 + (-raw[c]).exp())))
        .collect();
    loss += parameter_terms(context.config, &source, &pass, &state.labels, &mut gradients);
    Outcome { loss, mse: physical.mse, gradients }
}

/// Mean squared error of the physically based branch on one photograph; nothing is differentiated.
pub fn physical_error(context: &StepContext<'_>, state: &Learned, photo: &Photo) -> f32 {
    mean_squared_error(&physical_image(context, state, photo), photo)
}

/// The physically based branch as one photograph would show it.
pub(super) fn physical_image(context: &StepContext<'_>, state: &Learned, photo: &Photo) -> Vec<[f32; 3]> {
    let tables = context.operators.apply(&radiance_of(&state.model));
    let basis = cpu::indirect_basis(&tables);
    let Learned { model, .. } = state;
    let order = model.gaussians.visibility_order();
    let shader = SurfaceShader { tables: &tables, options: &model.shading, order };
    let source = source(state, &basis).under(shader);
    let view = View::new(&photo.camera, source.options);
    let pass =
        Pass::forward(&source, view, channels(context.config, model).blended, EarlyStop::WhenSaturated);
    shader.images(&pass, context.background).physical
}

/// Mean squared error of the radiance branch on one photograph; nothing is differentiated.
pub fn radiance_error(context: &StepContext<'_>, state: &Learned, photo: &Photo) -> f32 {
    let basis = [[0.0; 3]; 16];
    let source = source(state, &basis);
    let pass = Pass::forward(
        &source,
        View::new(&photo.camera, source.options),
        Channels::Colour,
        EarlyStop::WhenSaturated,
    );
    mean_squared_error(&radiance_image(&pass, context.background), photo)
}

fn mean_squared_error(image: &[[f32; 3]], photo: &Photo) -> f32 {
    let squares = image.iter().zip(&photo.pixels);
    let sum: f64 = squares.flat_map(|(a, b)| (0..3).map(move |c| f64::from(a[c] - b[c]).powi(2))).sum();
    (sum / (3 * photo.pixels.len()).max(1) as f64) as f32
}

/// Summed blending weight, in pixels, that each Gaussian has in one photograph.
pub fn weights_in(state: &Learned, photo: &Photo) -> Vec<f32> {
    let basis = [[0.0; 3]; 16];
    let source = source(state, &basis);
    let pass = Pass::forward(
        &source,
        View::new(&photo.camera, source.options),
        Channels::Colour,
        EarlyStop::WhenSaturated,
    );
    let mut out = vec![0.0; source.gaussians.len()];
    for (splat, label) in pass.splats.iter().zip(cpu::backward_labels(&pass)) {
        out[splat.gaussian as usize] = label.weight;
    }
    out
}

/// Outward unit normals of all Gaussians, as the last measurement of visibility has them.
pub fn normals(state: &Learned) -> Vec<[f32; 3]> {
    outward_normals(&source(state, &[[0.0; 3]; 16]))
}

/// Channels of a step that trains materials, and those of them that its backward pass carries: visibility and indirect
/// light only when they are learned.
pub(super) fn channels(config: &TrainConfig, model: &Model) -> StepChannels {
    let full = Channels::Full(model.gaussians.width(Field::Visibility));
    let learned = config.labels != LabelSource::Probes || model.shading.indirect == IndirectForm::Learned;
    let differentiated = if learned { full } else { Channels::Material };
    match model.shading.shade_at {
        // What is shaded at the Gaussians needs no visibility in the pixel.
        ShadeAt::Gaussian => StepChannels { blended: differentiated, differentiated },
        ShadeAt::Pixel => StepChannels { blended: full, differentiated },
    }
}

fn parameter_terms(
    config: &TrainConfig,
    source: &AttributeSource<'_>,
    pass: &Pass,
    labels: &[f32],
    gradients: &mut Gradients,
) -> f32 {
    let (w, g) = (&config.weights, source.gaussians);
    let mut loss = aggregation::aggregation(g, w.aggregation, gradients);
    loss += terms::residual(g, w.residual, gradients);
    loss += terms::flatness(g, w.flatness, gradients);
    if source.options.visibility != VisibilityForm::Off {
        if matches!(config.labels, LabelSource::Backward | LabelSource::Both) {
            loss += terms::backward_labels(g, pass, source.options.visibility, w.visibility, gradients);
        }
        if config.labels == LabelSource::Both {
            loss += terms::probe_labels(g, labels, w.visibility, gradients);
        }
    }
    loss
}

/// Measures visibility and gathers bounced light anew (docs/MODEL.md section 6).
///
/// With labels `Probes` the field *is* the measurement. `twice`: the first measurement also finds each Gaussian's open
/// side, which the second one starts from.
pub fn refresh_probes(config: &TrainConfig, operators: &EnvOperators, state: &mut Learned, twice: bool) {
    let tables = operators.apply(&radiance_of(&state.model));
    let order = state.model.gaussians.visibility_order();
    let basis = [[0.0; 3]; 16];
    let gathers = config.bounces > 0 && state.model.shading.indirect == IndirectForm::Gathered;
    if state.model.shading.visibility == VisibilityForm::Off && !gathers {
        return;
    }
    for _ in 0..if twice { 2 } else { 1 } {
        let source = source(state, &basis);
        let directions = fibonacci_sphere(config.probe_directions as usize);
        let probes = Probes::measure(&source, directions, ProbeSettings::of(source.options));
        let labels = probes.coefficients(order);
        if gathers {
            let transport = Transport::new(&probes, outward_normals(&source));
            state.gathered = transport.gather(&source, &tables, config.bounces as usize);
        }
        if config.labels == LabelSource::Probes
            || (config.labels == LabelSource::Both && state.labels.is_empty())
        {
            state.model.gaussians.field_mut(Field::Visibility).copy_from_slice(&labels);
        }
        state.labels = labels;
    }
}
