//! Everything a training keeps on the device, and one optimisation step in terms of the kernels' hosts.
//!
//! A step is two submissions: one that finds out how many tile instances the view has, and one with all the rest, which
//! ends with a read of sixteen sums. Nothing else crosses the bus.

use crate::engine::channel::Channels;
use crate::engine::gpu::density::{self, DensitySignals, GatherPlan};
use crate::engine::gpu::gather::{GatherSource, gather};
use crate::engine::gpu::light::{Constants, LightWeights, TrainingLight};
use crate::engine::gpu::losses::{ImageTerm, LOSS_SLOTS, LossSlot, surface_terms};
use crate::engine::gpu::model::ModelBuffers;
use crate::engine::gpu::probes::Probes;
use crate::engine::gpu::raster::groups;
use crate::engine::gpu::scan::grow;
use crate::engine::gpu::shading::{
    Images, ShadeGradients, ShadeJob, ShadingUniform, radiance_image, radiance_image_backward, shade,
    shade_backward, show_lit, show_lit_backward,
};
use crate::engine::gpu::update::{STATUS_WORDS, StepInput, Sums, Updater, Upstream};
use crate::engine::gpu::{AttributeBuffers, Buffer, CameraUniform, Gpu, GpuError, Raster, Recorder};
use crate::engine::{ProbeSettings, fibonacci_sphere};
use crate::light::EnvOperators;
use crate::scene::{IndirectForm, ShadeAt, ShadingOptions};

mod state;
mod step;

pub use state::HostState;
pub use step::{ImageWeights, Step, StepSums, StepWeights};

/// What is measured, not learned.
#[derive(Debug, Clone, Default)]
pub struct Measured {
    /// Probe labels, `[Gaussian][coefficient]`.
    pub labels: Option<Buffer<f32>>,
    /// Gathered light, 6 floats a Gaussian.
    pub gathered: Option<Buffer<f32>>,
    /// True once anything was measured, also for Gaussians that are gone.
    pub ever: bool,
}

/// The state a training can return to.
#[derive(Debug)]
struct Kept {
    model: ModelBuffers,
    density: Buffer<[f32; 2]>,
    measured: Measured,
}

/// Buffers of the size of the picture.
#[derive(Debug, Clone)]
struct Canvas {
    pixels: usize,
    images: Images,
    by_images: Images,
    /// Partial derivatives of the image terms, three elements a pixel.
    partials: Buffer<[f32; 4]>,
    /// Gradient by the buffers themselves, two elements a pixel.
    by_buffers: Buffer<[f32; 4]>,
}

impl Canvas {
    fn new(gpu: &Gpu, pixels: usize) -> Result<Self, GpuError> {
        Ok(Self {
            pixels,
            images: Images::new(gpu, pixels)?,
            by_images: Images::new(gpu, pixels)?,
            partials: gpu.buffer("partial derivatives of the image terms", 3 * pixels)?,
            by_buffers: gpu.buffer("gradient by the buffers", 2 * pixels)?,
        })
    }
}

/// A training on the device.
#[derive(Debug)]
pub struct Training {
    gpu: Gpu,
    /// Parameters and moments.
    pub model: ModelBuffers,
    /// Sum of pulls and steps on screen, by Gaussian.
    pub density: Buffer<[f32; 2]>,
    /// What is measured, not learned.
    pub measured: Measured,
    options: ShadingOptions,
    order: usize,
    raster: Raster,
    light: TrainingLight,
    constants: Constants,
    losses: Buffer<f32>,
    updater: Updater,
    canvas: Option<Canvas>,
    by_gbuffer: Option<Buffer<[f32; 4]>>,
    globals_gradient: Buffer<f32>,
    status: Buffer<u32>,
    kept: Option<Kept>,
}

/// How visibility and bounced light are measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// Probe directions.
    pub directions: usize,
    /// Rounds of gathered light, or none at all.
    pub bounces: Option<usize>,
    /// The measurement becomes the visibility field.
    pub replaces_field: bool,
    /// The measurement becomes the visibility field if there was none before.
    pub starts_field: bool,
}

impl Training {
    /// Takes a training over.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] or [`GpuError::OutOfMemory`] when it does not fit.
    pub fn new(gpu: &Gpu, operators: &EnvOperators, state: &HostState<'_>) -> Result<Self, GpuError> {
        let (model, density, measured) = state.upload(gpu)?;
        Ok(Self {
            options: state.model.shading,
            order: operators.order(),
            raster: Raster::new(gpu)?,
            light: TrainingLight::new(gpu, operators)?,
            constants: Constants::upload(gpu)?,
            losses: gpu.buffer("losses", LOSS_SLOTS)?,
            updater: Updater::new(gpu)?,
            by_gbuffer: None,
            canvas: None,
            globals_gradient: gpu.buffer("gradient of what is shared", model.globals.len())?,
            status: gpu.buffer("status", STATUS_WORDS)?,
            kept: None,
            gpu: gpu.clone(),
            model,
            density,
            measured,
        })
    }

    /// Goes on from another state.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn load(&mut self, state: &HostState<'_>) -> Result<(), GpuError> {
        (self.model, self.density, self.measured) = state.upload(&self.gpu)?;
        Ok(())
    }

    /// Goes on from a state of another shape, with its operators, and keeps it.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn reshape(&mut self, operators: &EnvOperators, state: &HostState<'_>) -> Result<(), GpuError> {
        // What is kept goes first: it could not be returned to.
        self.kept = None;
        self.load(state)?;
        self.options = state.model.shading;
        self.order = operators.order();
        self.light = TrainingLight::new(&self.gpu, operators)?;
        self.globals_gradient = self.gpu.buffer("gradient of what is shared", self.model.globals.len())?;
        self.keep()
    }

    /// One optimisation step; waits for its sums.
    ///
    /// # Errors
    /// What went wrong on the device.
    pub fn step(&mut self, step: &Step<'_>) -> Result<StepSums, GpuError> {
        let view = CameraUniform::new(&step.view);
        self.raster.prepare(&view, &self.model.layout, &self.model.params)?;
        let gpu = self.gpu.clone();
        let mut recorder = gpu.record();
        recorder.clear(&self.losses);
        recorder.clear(&self.globals_gradient);
        recorder.clear(&self.status);
        let groups = groups(step.differentiated);
        let by_gbuffer =
            grow(&gpu, "gradient of the G-buffer", &mut self.by_gbuffer, groups * view.pixels())?;
        let canvas = self.canvas(view.pixels())?;
        let is_material = is_shaded(step.channels);
        if is_material {
            self.light.apply(&mut recorder, &self.model, &step.weights.light, &self.losses);
        }
        self.picture(&mut recorder, step, &view, &canvas)?;
        self.raster.blend_backward(&mut recorder, &by_gbuffer, groups)?;
        self.light_backward(&mut recorder, step, &view)?;
        self.update(&mut recorder, step, &view, groups, is_material)?;
        // The status rides in the last slot, which no term has: one read is one round trip less.
        recorder.copy(&self.status.cast(), 0, &self.losses, step::STATUS_SLOT, 1);
        recorder.submit()?;
        let sums = gpu.read(&self.losses, 0..LOSS_SLOTS)?;
        let poisoned = sums[step::STATUS_SLOT].to_bits() != 0;
        let loss = step::objective(&sums, &step.weights);
        let leading = if is_material { LossSlot::PhysicalSquared } else { LossSlot::RadianceSquared };
        Ok(StepSums { loss, mse: sums[leading as usize], finite: loss.is_finite() && !poisoned })
    }

    fn canvas(&mut self, pixels: usize) -> Result<Canvas, GpuError> {
        match &self.canvas {
            Some(canvas) if canvas.pixels == pixels => Ok(canvas.clone()),
            _ => {
                // The old one goes first: both at once may not fit.
                self.canvas = None;
                Ok(self.canvas.insert(Canvas::new(&self.gpu, pixels)?).clone())
            }
        }
    }

    /// From attributes to images, and from the terms on images and buffers to the gradient of the G-buffer.
    fn picture(
        &mut self,
        recorder: &mut Recorder<'_>,
        step: &Step<'_>,
        view: &CameraUniform,
        canvas: &Canvas,
    ) -> Result<(), GpuError> {
        let source = attribute_buffers(&self.model, &self.measured, &self.light);
        let shading = ShadingUniform::new(&self.options, step.background);
        let (light, constants) = (&self.light.light, &self.constants);
        let n_visibility = self.model.layout.n_visibility as usize;
        let job = is_shaded(step.channels).then_some(ShadeJob {
            view,
            shading: &shading,
            n_visibility,
            light,
            constants,
        });
        let is_lit = self.options.shade_at == ShadeAt::Gaussian;
        self.raster.attributes(recorder, step.channels, &source)?;
        if let Some(job) = job.as_ref().filter(|_| is_lit) {
            self.raster.light(recorder, job, step.channels, &source)?;
        }
        self.raster.blend(recorder, step.channels, true)?;
        let (Some(gbuffer), Some(by_gbuffer)) = (&self.raster.gbuffer, &self.by_gbuffer) else {
            return Err(GpuError::Internal("a pass without G-buffer".to_owned()));
        };
        let weights = &step.weights;
        recorder.stage("shade");
        match &job {
            Some(job) if is_lit => show_lit(recorder, job, gbuffer, &canvas.images),
            Some(job) => shade(recorder, job, gbuffer, &canvas.images)?,
            None => radiance_image(recorder, view, step.background, gbuffer, &canvas.images.radiance),
        }
        recorder.stage("losses");
        let term = |image, weights: &ImageWeights, slot| ImageTerm {
            view,
            image,
            photo: step.photo,
            slot,
            l1: weights.l1,
            ssim: weights.ssim,
            partials: &canvas.partials,
        };
        if job.is_some() {
            let physical = term(&canvas.images.physical, &weights.physical, LossSlot::PhysicalL1);
            physical.record(recorder, &canvas.by_images.physical, &self.losses);
        }
        let radiance = term(&canvas.images.radiance, &weights.radiance, LossSlot::RadianceL1);
        radiance.record(recorder, &canvas.by_images.radiance, &self.losses);
        let buffers = [gbuffer, step.photo, &canvas.by_buffers];
        surface_terms(recorder, view, step.channels, &weights.surface, buffers, &self.losses);
        recorder.stage("shade backward");
        let (seen, carried) = (groups(step.channels) as u64, groups(step.differentiated) as u64);
        // The G-buffer read, its gradient written, images and buffer gradients read; four taps of a table a coefficient.
        recorder.work(
            view.pixels() as u64 * 16 * (seen + carried + 4),
            view.pixels() as u64 * (600 + 4 * 3 * 4 * 4 * seen.saturating_sub(5)),
        );
        let gradients = ShadeGradients {
            gbuffer,
            by_images: &canvas.by_images,
            by_buffers: &canvas.by_buffers,
            by_gbuffer,
            by_tables: &self.light.tables_gradient,
            all_channels: matches!(step.differentiated, Channels::Full(_)),
        };
        match &job {
            Some(job) if is_lit => show_lit_backward(recorder, job, &gradients),
            Some(job) => shade_backward(recorder, job, &gradients)?,
            None => radiance_image_backward(
                recorder,
                view,
                step.background,
                &canvas.by_images.radiance,
                &canvas.by_buffers,
                by_gbuffer,
                step.channels,
            ),
        }
        Ok(())
    }

    /// From the light of the Gaussians to what it is made of.
    fn light_backward(
        &self,
        recorder: &mut Recorder<'_>,
        step: &Step<'_>,
        view: &CameraUniform,
    ) -> Result<(), GpuError> {
        if self.options.shade_at != ShadeAt::Gaussian || !is_shaded(step.channels) {
            return Ok(());
        }
        let job = ShadeJob {
            view,
            shading: &ShadingUniform::new(&self.options, step.background),
            n_visibility: self.model.layout.n_visibility as usize,
            light: &self.light.light,
            constants: &self.constants,
        };
        let source = attribute_buffers(&self.model, &self.measured, &self.light);
        self.raster.light_backward(recorder, &job, step.channels, &source, &self.light.tables_gradient)
    }

    /// From the splats' gradients to new parameters.
    fn update(
        &mut self,
        recorder: &mut Recorder<'_>,
        step: &Step<'_>,
        view: &CameraUniform,
        groups: usize,
        is_material: bool,
    ) -> Result<(), GpuError> {
        let terms = step.weights.parameters;
        if terms.view_labels != 0.0 {
            self.raster.backward_labels(recorder)?;
        }
        let (Some(splats), Some(gradients)) = (&self.raster.splats, &self.raster.splat_gradients) else {
            return Err(GpuError::Internal("a way back without splats".to_owned()));
        };
        let learned = is_material && self.options.indirect == IndirectForm::Learned;
        let basis = (&self.light.light.indirect_basis, &self.light.basis_gradient);
        let sums = Sums {
            globals_gradient: &self.globals_gradient,
            losses: &self.losses,
            density: &self.density,
            status: &self.status,
        };
        let input = StepInput {
            model: &self.model,
            upstream: Upstream {
                view,
                splats,
                gradients,
                groups,
                indirect_basis: learned.then_some(basis),
                probe_labels: self.measured.labels.as_ref(),
                view_labels: self.raster.labels.as_ref().filter(|_| terms.view_labels != 0.0),
            },
            sums,
            terms,
        };
        self.updater.step(recorder, &input, &step.rates, step.ages);
        if is_material {
            let weights = &step.weights.light;
            self.light.backward(recorder, &self.model, weights, learned, &self.globals_gradient);
            self.updater.step_globals(recorder, &self.model, &sums, &step.rates, step.ages);
        }
        Ok(())
    }

    /// Measures visibility and gathers bounced light anew (docs/MODEL.md section 6).
    ///
    /// # Errors
    /// What went wrong on the device.
    pub fn measure(&mut self, how: &Measurement) -> Result<(), GpuError> {
        let (gpu, layout) = (self.gpu.clone(), self.model.layout);
        let settings = ProbeSettings::of(&self.options);
        let directions = fibonacci_sphere(how.directions);
        let probes = Probes::measure(&gpu, &self.model.params, &layout, settings, &directions, self.order)?;
        let mut recorder = gpu.record();
        if let Some(bounces) = how.bounces {
            self.light.apply(&mut recorder, &self.model, &LightWeights::default(), &self.losses);
            let source = GatherSource {
                params: &self.model.params,
                model: &layout,
                globals: &self.model.globals,
                tables: &self.light.light.values,
                shape: &self.light.light.layout,
            };
            self.measured.gathered = Some(gather(&mut recorder, &probes, &source, bounces)?);
        }
        if how.replaces_field || (how.starts_field && !self.measured.ever) {
            probes.store(&mut recorder, &self.model.params, &layout)?;
        }
        recorder.submit()?;
        self.measured.labels = Some(probes.coefficients);
        self.measured.ever = true;
        Ok(())
    }

    /// What density control chooses from.
    ///
    /// # Errors
    /// What went wrong on the device.
    pub fn signals(&self, with_means: bool) -> Result<DensitySignals, GpuError> {
        density::read_signals(&self.gpu, &self.model, &self.density, with_means)
    }

    /// Rebuilds the model as `plan` says, and clears the statistics. Labels and gathered light of the old Gaussians are
    /// dropped: measure anew.
    ///
    /// # Errors
    /// When the device has no memory left.
    pub fn rebuild(&mut self, plan: &GatherPlan) -> Result<(), GpuError> {
        let gpu = self.gpu.clone();
        let mut recorder = gpu.record();
        self.model = density::gather(&mut recorder, &self.model, plan)?;
        self.density = gpu.buffer("density statistics", plan.len())?;
        recorder.clear(&self.density);
        recorder.submit()?;
        self.measured = Measured { ever: self.measured.ever, ..Measured::default() };
        Ok(())
    }

    /// Makes this the state that [`Self::restore`] returns to.
    ///
    /// # Errors
    /// When the device has no memory left for a copy.
    pub fn keep(&mut self) -> Result<(), GpuError> {
        // The old copy goes first: three states at once may not fit.
        self.kept = None;
        self.kept = Some(self.copied(&self.model, &self.density, &self.measured)?);
        Ok(())
    }

    /// Returns to the state kept last.
    ///
    /// # Errors
    /// When nothing was kept, or the device has no memory left for a copy.
    pub fn restore(&mut self) -> Result<(), GpuError> {
        let kept = self.kept.as_ref().ok_or_else(|| GpuError::Internal("no state was kept".to_owned()))?;
        let copy = self.copied(&kept.model, &kept.density, &kept.measured)?;
        (self.model, self.density, self.measured) = (copy.model, copy.density, copy.measured);
        Ok(())
    }

    fn copied(
        &self,
        model: &ModelBuffers,
        density: &Buffer<[f32; 2]>,
        measured: &Measured,
    ) -> Result<Kept, GpuError> {
        let mut recorder = self.gpu.record();
        let mut copy = |buffer: &Buffer<f32>| -> Result<Buffer<f32>, GpuError> {
            let out = self.gpu.buffer("kept state", buffer.len())?;
            recorder.copy(buffer, 0, &out, 0, buffer.len());
            Ok(out)
        };
        let model = ModelBuffers {
            params: copy(&model.params)?,
            first: copy(&model.first)?,
            second: copy(&model.second)?,
            globals: copy(&model.globals)?,
            globals_first: copy(&model.globals_first)?,
            globals_second: copy(&model.globals_second)?,
            ..model.clone()
        };
        let density = copy(&density.cast())?.cast();
        let measured = Measured {
            labels: measured.labels.as_ref().map(&mut copy).transpose()?,
            gathered: measured.gathered.as_ref().map(&mut copy).transpose()?,
            ever: measured.ever,
        };
        recorder.submit()?;
        Ok(Kept { model, density, measured })
    }
}

/// Whether a pass shows the physically based branch.
fn is_shaded(channels: Channels) -> bool {
    matches!(channels, Channels::Material | Channels::Full(_))
}

fn attribute_buffers<'a>(
    model: &'a ModelBuffers,
    measured: &'a Measured,
    light: &'a TrainingLight,
) -> AttributeBuffers<'a> {
    AttributeBuffers {
        params: &model.params,
        globals: &model.globals,
        gathered: measured.gathered.as_ref(),
        indirect_basis: Some(&light.light.indirect_basis),
    }
}
