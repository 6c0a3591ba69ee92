//! Rendered frames of a finished model on the device.

mod light;
mod traced;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock};

use rayon::prelude::*;

use crate::gpu::frame::{FrameBranches, FramePass};
use crate::gpu::frames::light::{GpuFrameLight, RayResources};
use crate::gpu::gather::{LightProbes, add_sky_shadows, gather, ungathered};
use crate::gpu::light::{Constants, LightBuffers};
use crate::gpu::lock::locked;
use crate::gpu::model::LayoutUniform;
use crate::gpu::permutations::groups;
use crate::gpu::probes::{self, ProbeBuffers};
use crate::gpu::raster::{Projected, Raster};
use crate::gpu::rays::{RayMemory, TreeBuffers};
use crate::gpu::resolve::{PixelLight, Planes};
use crate::gpu::shading::Shading;
use crate::gpu::{AttributeSource, Buffer, CameraUniform, Gpu, ReadbackData, ReadbackTicket, Recorder};
use crate::{
    BOUNCES, ColourMode, DeviceError, Frame, FrameJob, FrameLight, FrameRenderer, HostModel,
    PROBE_DIRECTIONS, ProbeSettings, RasterCamera, RayLight, fibonacci_sphere, indirect_basis,
};
use relume_layout::channel::Channels;
use relume_layout::constants::EarlyStop;
use relume_scene::light::LightTables;
use relume_scene::{DisplayRange, Illumination, IndirectForm, Output, ShadingOptions, SplitLight};

/// Number of probe directions of a model with too many Gaussians for [`PROBE_DIRECTIONS`] in one binding.
const MIN_PROBE_DIRECTIONS: usize = 96;
/// Smallest number of pixels per thread when a frame is unpacked.
const SPLIT: usize = 1 << 14;

/// Memory that successive frames share.
struct Scratch {
    raster: Raster,
    planes: Option<Planes>,
    rays: RayMemory,
    /// Measured visibility, created on first use; independent of the light.
    probes: Option<ProbeBuffers>,
}

/// A finished model in device memory. Shared between threads.
pub struct GpuFrameRenderer {
    gpu: Gpu,
    host: Arc<HostModel>,
    /// The model without indirect light.
    source: AttributeSource,
    options: ShadingOptions,
    sh_degree: usize,
    constants: Constants,
    scratch: Mutex<Scratch>,
    /// The tree of occluders for rays, created on first use.
    tree: OnceLock<TreeBuffers>,
}

impl GpuFrameRenderer {
    /// Uploads the model of `host`.
    ///
    /// # Errors
    /// [`DeviceError::TooLarge`] or [`DeviceError::OutOfMemory`] when it does not fit.
    pub fn new(gpu: &Gpu, host: HostModel) -> Result<Self, DeviceError> {
        let model = host.model();
        let source = AttributeSource {
            layout: LayoutUniform::new(&model.gaussians, &model.shading),
            params: gpu.upload_gaussians(&model.gaussians)?,
            globals: gpu.upload("prototypes", model.prototypes.as_flattened())?,
            gathered: None,
            indirect_basis: None,
        };
        Ok(Self {
            source,
            options: model.shading,
            sh_degree: model.gaussians.visibility_degree(),
            constants: Constants::upload(gpu)?,
            scratch: Mutex::new(Scratch {
                raster: Raster::new(gpu)?,
                planes: None,
                rays: RayMemory::default(),
                probes: None,
            }),
            tree: OnceLock::new(),
            gpu: gpu.clone(),
            host: Arc::new(host),
        })
    }

    /// The light that the model's surfaces send each other under `tables`, then the arriving share of each dominant light; `None`
    /// if there is neither.
    fn gather(
        &self,
        tables: &LightTables,
        buffers: &LightBuffers,
    ) -> Result<Option<Buffer<f32>>, DeviceError> {
        let mut scratch = locked(&self.scratch);
        let AttributeSource { params, layout, .. } = &self.source;
        let lights: Vec<SplitLight> = tables.lights.iter().map(SplitLight::from).collect();
        let lights = LightProbes::measure(&self.gpu, params, layout, &self.options, &lights)?;
        if self.options.indirect != IndirectForm::Gathered {
            let mut recorder = self.gpu.record();
            let arriving = match &lights {
                Some(_) => Some(ungathered(&mut recorder, layout.n as usize, lights.as_ref())?),
                None => None,
            };
            recorder.submit()?;
            return Ok(arriving);
        }
        let probes = match &mut scratch.probes {
            Some(probes) => probes,
            none => none.insert(self.measure_probes()?),
        };
        let mut recorder = self.gpu.record();
        let gathered = gather(&mut recorder, probes, &self.source, buffers, BOUNCES, lights.as_ref())?;
        recorder.submit()?;
        Ok(Some(gathered))
    }

    /// `gathered` with the shadows of the sky under `light`; itself where the model has none.
    fn with_sky_shadows(
        &self,
        gathered: &Option<Buffer<f32>>,
        light: &LightBuffers,
    ) -> Result<Option<Buffer<f32>>, DeviceError> {
        let scratch = locked(&self.scratch);
        let (Some(probes), Some(gathered), true) =
            (&scratch.probes, gathered, self.options.has_sky_shadows())
        else {
            return Ok(gathered.clone());
        };
        let shaded: Buffer<f32> =
            self.gpu.buffer("gathered light with shadows of the sky", gathered.len())?;
        let mut recorder = self.gpu.record();
        recorder.copy(gathered, 0, &shaded, 0, gathered.len());
        add_sky_shadows(&mut recorder, probes, &self.source, light, &shaded)?;
        recorder.submit()?;
        Ok(Some(shaded))
    }

    fn measure_probes(&self) -> Result<ProbeBuffers, DeviceError> {
        let settings = ProbeSettings::of(&self.options);
        let AttributeSource { params, layout, .. } = &self.source;
        // Transmittances by direction and Gaussian must fit one binding.
        let most = self.gpu.report().max_binding / (4 * u64::from(layout.n.max(1)));
        let directions = fibonacci_sphere(PROBE_DIRECTIONS.min(most as usize).max(MIN_PROBE_DIRECTIONS));
        probes::measure(&self.gpu, params, layout, settings, &directions, self.sh_degree)
    }

    /// All channels of the model.
    fn full(&self) -> Channels {
        Channels::Full(self.source.layout.n_visibility as usize)
    }

    /// The model under `light`, with `gathered` light.
    fn lit_source(&self, light: &GpuFrameLight, gathered: &Option<Buffer<f32>>) -> AttributeSource {
        AttributeSource {
            gathered: gathered.clone(),
            indirect_basis: Some(light.buffers.indirect_basis.clone()),
            ..self.source.clone()
        }
    }

    fn shading(&self, light: &LightBuffers) -> Shading {
        Shading {
            options: self.options,
            background: [0.0; 3],
            range: DisplayRange::Unit,
            light: light.clone(),
            constants: self.constants.clone(),
        }
    }

    /// The frame that `draw` makes of a projected view of `source`; drawn again when the view's tile lists were too short. Another
    /// thread may record its frame while this one waits for the device.
    fn draw(
        &self,
        view: &RasterCamera,
        source: &AttributeSource,
        draw: impl Fn(&mut Recorder<'_>, Projected<'_>, FrameScratch<'_>) -> Result<PendingOutputs, DeviceError>,
    ) -> Result<Frame, DeviceError> {
        loop {
            let mut scratch = locked(&self.scratch);
            let Scratch { raster, planes, rays, .. } = &mut *scratch;
            let mut recorder = self.gpu.record();
            let projected = raster.record(&mut recorder, &CameraUniform::new(view), source)?;
            let list_status = recorder.fetch(projected.list_status(), 0..projected.list_status().len());
            let drawn = draw(&mut recorder, projected, FrameScratch { planes, rays })?;
            let submission = recorder.submit()?;
            // The device executes submissions in order: this frame is copied before the next one writes.
            drop(scratch);
            let arrival = submission.wait_for_data()?;
            if locked(&self.scratch).raster.apply_list_status(&arrival.read(&list_status)?)? {
                let planes = drawn.planes(&arrival)?;
                return Ok(Frame { width: view.width as u32, height: view.height as u32, planes });
            }
        }
    }

    /// Coverage and colour from Gaussians that are shaded before blending.
    fn colours(
        &self,
        recorder: &mut Recorder<'_>,
        projected: Projected<'_>,
        shading: &Shading,
    ) -> Result<PendingOutputs, DeviceError> {
        let shaded = projected.attributes(recorder, Channels::Material)?.colours(recorder, shading)?;
        let frame = shaded.blend(recorder, EarlyStop::WhenSaturated)?;
        let pixels = frame.camera().pixels();
        Ok(PendingOutputs::Colours(recorder.fetch(frame.gbuffer(), 0..pixels)))
    }

    fn outputs(
        &self,
        recorder: &mut Recorder<'_>,
        projected: Projected<'_>,
        shading: &Shading,
        planes: &mut Option<Planes>,
        job: &FrameJob<'_>,
    ) -> Result<PendingOutputs, DeviceError> {
        let pass = FramePass {
            channels: self.full(),
            blending: EarlyStop::WhenSaturated,
            branches: FrameBranches::Both(Box::new(shading.clone())),
        };
        let frame = pass.forward(recorder, projected)?;
        self.resolved(recorder, frame.camera(), frame.gbuffer(), (shading, PixelLight::Tables), planes, job)
    }

    /// The outputs of a G-buffer.
    fn resolved(
        &self,
        recorder: &mut Recorder<'_>,
        camera: &CameraUniform,
        gbuffer: &Buffer<[f32; 4]>,
        (shading, light): (&Shading, PixelLight<'_>),
        planes: &mut Option<Planes>,
        job: &FrameJob<'_>,
    ) -> Result<PendingOutputs, DeviceError> {
        if !planes.as_ref().is_some_and(|p| p.fits(camera.pixels(), job.outputs)) {
            *planes = None;
        }
        let planes = match planes {
            Some(planes) => planes,
            none => none.insert(Planes::new(&self.gpu, camera.pixels(), job.outputs)?),
        };
        recorder.stage("resolve");
        planes.resolve(recorder, camera, shading, gbuffer, light, job.depth_scale)?;
        Ok(PendingOutputs::Outputs(planes.fetch(recorder)))
    }
}

/// Memory of [`Scratch`] that one frame uses.
struct FrameScratch<'a> {
    planes: &'a mut Option<Planes>,
    rays: &'a mut RayMemory,
}

/// Outputs of a frame that a submission copies to the host.
enum PendingOutputs {
    /// Coverage and colour of each pixel.
    Colours(ReadbackTicket<[f32; 4]>),
    /// Each output separately.
    Outputs(Vec<(Output, ReadbackTicket<f32>)>),
}

impl PendingOutputs {
    fn planes(self, arrival: &ReadbackData) -> Result<BTreeMap<Output, Vec<f32>>, DeviceError> {
        match self {
            Self::Colours(pixels) => arrival.with(&pixels, |pixels: &[[f32; 4]]| {
                let (mut rgb, mut alpha) = (vec![[0.0; 3]; pixels.len()], vec![0.0; pixels.len()]);
                pixels.par_iter().zip(&mut rgb).zip(&mut alpha).with_min_len(SPLIT).for_each(
                    |((pixel, rgb), alpha)| {
                        let [a, r, g, b] = *pixel;
                        (*alpha, *rgb) = (a, [r, g, b]);
                    },
                );
                BTreeMap::from([(Output::Rgb, rgb.into_flattened()), (Output::Alpha, alpha)])
            }),
            Self::Outputs(planes) => {
                planes.into_iter().map(|(output, values)| Ok((output, arrival.read(&values)?))).collect()
            }
        }
    }
}

impl FrameRenderer for GpuFrameRenderer {
    fn host(&self) -> &Arc<HostModel> {
        &self.host
    }

    fn is_gpu(&self) -> bool {
        true
    }

    /// As many rows as have a G-buffer that fits one binding.
    fn max_rows(&self, width: usize, colour: ColourMode) -> usize {
        let groups = match colour {
            ColourMode::Alone => 1,
            ColourMode::WithGBuffer => groups(self.full()),
        };
        let report = self.gpu.report();
        let row_bytes = (width * groups * 16).max(1) as u64;
        (report.max_binding.min(report.max_buffer) / row_bytes).max(1) as usize
    }

    fn prepare_light(self: Arc<Self>, light: &Illumination) -> Result<Box<dyn FrameLight>, DeviceError> {
        let tables = &self.host.light_tables(light);
        let buffers = LightBuffers::upload(&self.gpu, tables, self.sh_degree, &indirect_basis(tables))?;
        let gathered = self.gather(tables, &buffers)?;
        let with_sky_shadows = self.with_sky_shadows(&gathered, &buffers)?;
        Ok(Box::new(GpuFrameLight {
            renderer: self,
            buffers,
            gathered,
            with_sky_shadows,
            by_rays: RayResources::default(),
        }))
    }
}

impl FrameLight for GpuFrameLight {
    fn render(&self, job: &FrameJob<'_>) -> Result<Frame, DeviceError> {
        let renderer = &self.renderer;
        let (source, shading) =
            (renderer.lit_source(self, &self.with_sky_shadows), renderer.shading(&self.buffers));
        renderer.draw(&job.view, &source, |recorder, projected, reused| match job.colour {
            ColourMode::Alone => renderer.colours(recorder, projected, &shading),
            ColourMode::WithGBuffer => renderer.outputs(recorder, projected, &shading, reused.planes, job),
        })
    }

    fn render_by_rays(&self, job: &FrameJob<'_>, rays: &RayLight<'_>) -> Result<Frame, DeviceError> {
        self.trace(job, rays)
    }
}
