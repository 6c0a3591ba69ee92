//! A training on the GPU engine: the configuration's words into the device's.

use std::borrow::Cow;
use std::collections::HashMap;

use crate::engine::RowLayout;
use crate::engine::channel::{Channels, StepChannels};
use crate::engine::cpu::View;
use crate::engine::gpu::density::{GatherPlan, Origin};
use crate::engine::gpu::light::LightWeights;
use crate::engine::gpu::losses::SurfaceWeights;
use crate::engine::gpu::raster::GRADIENT_HEADER;
use crate::engine::gpu::training::{HostState, ImageWeights, Measurement, Step, StepWeights, Training};
use crate::engine::gpu::update::{Ages, ParameterTerms, Rates};
use crate::engine::gpu::{Buffer, Gpu, GpuError};
use crate::light::EnvOperators;
use crate::scene::{Field, IndirectForm, Model, VisibilityForm};
use crate::train::backend::{Backend, StepTask, StepValue};
use crate::train::dataset::Photo;
use crate::train::density::{self, Candidates, DensityStats};
use crate::train::optimiser::Moments;
use crate::train::state::Learned;
use crate::train::step::{self, StepContext};
use crate::train::{LabelSource, TrainConfig, TrainError};

/// Device memory that photographs may take; more of them are sent anew each step.
const PHOTO_BYTES: usize = 4 << 30;

/// The training on the device, and what of the model stays on the host.
pub(super) struct OnGpu {
    gpu: Gpu,
    training: Training,
    /// Shape, options and card of the model; its parameters are those of the last load.
    frame: Model,
    photos: HashMap<(usize, bool), Buffer<[f32; 4]>>,
    photo_bytes: usize,
}

fn host_state(learned: &Learned) -> HostState<'_> {
    let Learned { model, moments, density, labels, gathered } = learned;
    HostState {
        model,
        moments: [&moments.first, &moments.second],
        globals: [&moments.globals[0], &moments.globals[1]],
        density: [&density.pull, &density.seen],
        labels,
        gathered,
    }
}

impl OnGpu {
    pub(super) fn new(
        gpu: &Gpu,
        config: &TrainConfig,
        operators: &EnvOperators,
        learned: Learned,
        pixels: usize,
    ) -> Result<Self, TrainError> {
        check_size(gpu, config, &learned.model, pixels)?;
        let mut training = Training::new(gpu, operators, &host_state(&learned))?;
        training.keep()?;
        let (photos, photo_bytes) = (HashMap::new(), 0);
        Ok(Self { gpu: gpu.clone(), training, frame: learned.model, photos, photo_bytes })
    }

    /// The photograph in device memory; kept there while there is room.
    fn photo(&mut self, key: (usize, bool), photo: &Photo) -> Result<Buffer<[f32; 4]>, TrainError> {
        if let Some(kept) = self.photos.get(&key) {
            return Ok(kept.clone());
        }
        let alpha = |i: usize| photo.alpha.get(i).copied().unwrap_or(1.0);
        let pixels: Vec<[f32; 4]> =
            photo.pixels.iter().enumerate().map(|(i, [r, g, b])| [*r, *g, *b, alpha(i)]).collect();
        let buffer = self.gpu.upload("a photograph", &pixels)?;
        let bytes = size_of_val(&pixels[..]);
        if self.photo_bytes + bytes <= PHOTO_BYTES {
            self.photo_bytes += bytes;
            self.photos.insert(key, buffer.clone());
        }
        Ok(buffer)
    }

    /// Channels of a step's pass, and those its way back carries.
    fn channels(&self, task: &StepTask<'_>) -> StepChannels {
        let (config, progress) = (task.context.config, task.context.progress);
        if task.material {
            return step::channels(config, &self.frame);
        }
        let shaped = step::is_shaped(config, progress);
        let channels = if shaped { Channels::Geometry } else { Channels::Colour };
        StepChannels { blended: channels, differentiated: channels }
    }

    fn weights(&self, task: &StepTask<'_>, channels: Channels) -> StepWeights {
        let (config, w) = (task.context.config, &task.context.config.weights);
        let if_material = |weight: f32| if task.material { weight } else { 0.0 };
        let share = if task.material { config.radiance_weight(task.context.has_alpha) } else { 1.0 };
        let visible = task.material && self.frame.shading.visibility != VisibilityForm::Off;
        let labels = |sources: &[LabelSource]| {
            if visible && sources.contains(&config.labels) { w.visibility } else { 0.0 }
        };
        StepWeights {
            physical: ImageWeights { l1: if_material(w.l1), ssim: if_material(w.ssim) },
            radiance: ImageWeights { l1: w.l1 * share, ssim: w.ssim * share },
            surface: SurfaceWeights {
                coverage: if task.context.has_alpha { w.coverage } else { 0.0 },
                depth_normal: if channels == Channels::Colour { 0.0 } else { w.depth_normal },
                smoothness: w.smooth().map(if_material),
            },
            light: LightWeights {
                neutrality: if_material(w.light),
                exposure: if_material(w.exposure),
                daylight: if_material(config.daylight_weight(task.context.progress)),
            },
            parameters: ParameterTerms {
                aggregation: if_material(w.aggregation),
                residual: if_material(w.residual),
                flatness: w.flatness,
                probe_labels: labels(&[LabelSource::Both]),
                view_labels: labels(&[LabelSource::Backward, LabelSource::Both]),
            },
        }
    }
}

impl Backend for OnGpu {
    fn step(&mut self, task: &StepTask<'_>) -> Result<StepValue, TrainError> {
        let photo = self.photo(task.photo_key, task.photo)?;
        let StepChannels { blended: channels, differentiated } = self.channels(task);
        let sizes = &task.sizes;
        let sums = self.training.step(&Step {
            view: View::new(&task.photo.camera, &self.frame.shading),
            photo: &photo,
            background: task.context.background,
            channels,
            differentiated,
            weights: self.weights(task, channels),
            rates: Rates {
                fields: sizes.fields,
                prototypes: sizes.prototypes,
                environment: sizes.environment,
            },
            ages: Ages { geometry: task.ages[0], material: task.ages[1] },
        })?;
        Ok(StepValue { loss: sums.loss, mse: sums.mse, finite: sums.finite })
    }

    fn refresh_probes(&mut self, context: &StepContext<'_>, twice: bool) -> Result<(), TrainError> {
        let (config, shading) = (context.config, &self.frame.shading);
        let gathers = config.bounces > 0 && shading.indirect == IndirectForm::Gathered;
        if shading.visibility == VisibilityForm::Off && !gathers {
            return Ok(());
        }
        let how = Measurement {
            directions: config.probe_directions as usize,
            bounces: gathers.then_some(config.bounces as usize),
            replaces_field: config.labels == LabelSource::Probes,
            starts_field: config.labels == LabelSource::Both,
        };
        for _ in 0..if twice { 2 } else { 1 } {
            self.training.measure(&how)?;
        }
        Ok(())
    }

    fn refine(&mut self, budget: usize, eyes: Option<&[[f32; 3]]>) -> Result<(), TrainError> {
        let signals = self.training.signals(eyes.is_some())?;
        let (pull, seen) = signals.stats.iter().map(|s| (s[0], s[1])).unzip();
        let of = Candidates {
            means: signals.means.as_flattened(),
            log_scales: signals.log_scales.as_flattened(),
            opacity_logits: &signals.opacity_logits,
        };
        let plan = density::plan(of, &DensityStats { pull, seen }, budget, eyes);
        let mut gather = GatherPlan::default();
        for (source, side) in plan.source.iter().zip(&plan.side) {
            let origin = match *side {
                0.0 => Origin::Keep,
                side if side > 0.0 => Origin::UpperHalf,
                _ => Origin::LowerHalf,
            };
            gather.push(*source, origin);
        }
        Ok(self.training.rebuild(&gather)?)
    }

    fn load(&mut self, learned: Learned) -> Result<(), TrainError> {
        self.training.load(&host_state(&learned))?;
        self.frame = learned.model;
        Ok(())
    }

    fn reshape(&mut self, learned: Learned, operators: &EnvOperators) -> Result<(), TrainError> {
        self.training.reshape(operators, &host_state(&learned))?;
        self.frame = learned.model;
        Ok(())
    }

    fn keep(&mut self) -> Result<bool, TrainError> {
        self.training.keep()?;
        Ok(true)
    }

    fn restore(&mut self) -> Result<(), TrainError> {
        Ok(self.training.restore()?)
    }

    fn gaussians(&self) -> usize {
        self.training.model.len()
    }

    fn learned(&self) -> Result<Cow<'_, Learned>, TrainError> {
        let (gpu, buffers) = (&self.gpu, &self.training.model);
        let shape = &self.frame.gaussians;
        let mut model = self.frame.clone();
        model.gaussians = buffers.read_gaussians(gpu, &buffers.params, shape)?;
        [model.prototypes, model.env_raw] = buffers.read_globals(gpu, &buffers.globals)?;
        let globals =
            |buffer| -> Result<Vec<[f32; 3]>, TrainError> { Ok(buffers.read_globals(gpu, buffer)?.concat()) };
        let moments = Moments {
            first: buffers.read_gaussians(gpu, &buffers.first, shape)?,
            second: buffers.read_gaussians(gpu, &buffers.second, shape)?,
            globals: [globals(&buffers.globals_first)?, globals(&buffers.globals_second)?],
        };
        let stats = gpu.read(&self.training.density, 0..self.gaussians())?;
        let (pull, seen) = stats.iter().map(|s| (s[0], s[1])).unzip();
        let measured = &self.training.measured;
        let read = |buffer: &Option<Buffer<f32>>| match buffer {
            Some(buffer) => gpu.read(buffer, 0..buffer.len()),
            None => Ok(Vec::new()),
        };
        let gathered = read(&measured.gathered)?.as_chunks::<6>().0.to_vec();
        let (density, labels) = (DensityStats { pull, seen }, read(&measured.labels)?);
        Ok(Cow::Owned(Learned { model, moments, density, labels, gathered }))
    }

    fn engine(&self) -> &'static str {
        "gpu"
    }
}

/// Refuses a training whose largest array would not fit one binding of the device: of photographs of up to `pixels`
/// pixels, or of all its Gaussians.
fn check_size(gpu: &Gpu, config: &TrainConfig, model: &Model, pixels: usize) -> Result<(), GpuError> {
    let g = &model.gaussians;
    let attributes = Channels::Full(g.width(Field::Visibility)).stored();
    let gradients = GRADIENT_HEADER + attributes;
    let floats = RowLayout::new(g).row.max(gradients).max(config.probe_directions as usize) as u64;
    let report = gpu.report();
    let most = report.max_binding.min(report.max_buffer);
    let picture = 4 * (attributes * pixels) as u64;
    if picture > most {
        let what = format!("resolution: {} (photographs of {pixels} pixels)", config.resolution);
        return Err(GpuError::TooLarge { what, needs: picture, most });
    }
    let needs = floats * 4 * u64::from(config.max_gaussians.max(config.initial_gaussians));
    if needs <= most {
        return Ok(());
    }
    let fit = most / (4 * floats);
    let what = format!("max_gaussians: {} (at most {fit} fit this device)", config.max_gaussians);
    Err(GpuError::TooLarge { what, needs, most })
}
