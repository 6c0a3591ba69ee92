//! Rendered frames of a finished model on the device.

use std::collections::BTreeMap;
use std::sync::Mutex;

use crate::engine::channel::Channels;
use crate::engine::gpu::device::locked;
use crate::engine::gpu::frame::{Branches, FramePass};
use crate::engine::gpu::gather::gather;
use crate::engine::gpu::light::{Constants, LightBuffers};
use crate::engine::gpu::model::LayoutUniform;
use crate::engine::gpu::permutations::groups;
use crate::engine::gpu::probes::{self, ProbeBuffers};
use crate::engine::gpu::raster::{Projected, Raster};
use crate::engine::gpu::resolve::Planes;
use crate::engine::gpu::shading::Shading;
use crate::engine::gpu::{AttributeSource, Buffer, CameraUniform, Gpu, GpuError, Recorder};
use crate::engine::{Blending, Frame, Output, ProbeSettings, RasterCamera, fibonacci_sphere, indirect_basis};
use crate::light::LightTables;
use crate::scene::{IndirectForm, Model, ShadingOptions};

/// How the light that surfaces send each other is gathered for a model with `IndirectForm::Gathered`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GatherSettings {
    /// Probe directions.
    pub directions: usize,
    /// Rounds of gathered light.
    pub bounces: usize,
}

/// What a frame blends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameContent {
    /// Coverage and the shaded colour of each Gaussian: enough for [`Output::Rgb`] and [`Output::Alpha`].
    Colour,
    /// All channels: enough for every output.
    GBuffer,
}

/// A light in device memory, with what the model's surfaces send back under it.
pub struct FrameLight {
    buffers: LightBuffers,
    gathered: Option<Buffer<f32>>,
}

/// Memory that frames use one after the other.
struct Scratch {
    raster: Raster,
    planes: Option<Planes>,
    /// What hides what, once it was needed: it does not depend on the light.
    probes: Option<ProbeBuffers>,
}

/// A finished model in device memory. Shared between threads.
pub struct Frames {
    gpu: Gpu,
    /// The model without indirect light.
    source: AttributeSource,
    options: ShadingOptions,
    order: usize,
    /// From model to capture units.
    depth_scale: f32,
    gather: GatherSettings,
    constants: Constants,
    scratch: Mutex<Scratch>,
}

impl Frames {
    /// Uploads `model`.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] or [`GpuError::OutOfMemory`] when it does not fit.
    pub fn new(gpu: &Gpu, model: &Model, gather: GatherSettings) -> Result<Self, GpuError> {
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
            order: model.gaussians.visibility_order(),
            depth_scale: (1.0 / model.world_scale) as f32,
            gather,
            constants: Constants::upload(gpu)?,
            scratch: Mutex::new(Scratch { raster: Raster::new(gpu)?, planes: None, probes: None }),
            gpu: gpu.clone(),
        })
    }

    /// Uploads a light whose tables are for the model's visibility degree, and gathers what bounces under it.
    ///
    /// # Errors
    /// What went wrong on the device.
    pub fn prepare_light(&self, tables: &LightTables) -> Result<FrameLight, GpuError> {
        let buffers = LightBuffers::upload(&self.gpu, tables, self.order, &indirect_basis(tables))?;
        if self.options.indirect != IndirectForm::Gathered {
            return Ok(FrameLight { buffers, gathered: None });
        }
        let mut scratch = locked(&self.scratch);
        let probes = match &mut scratch.probes {
            Some(probes) => probes,
            none => none.insert(self.measure_probes()?),
        };
        let mut recorder = self.gpu.record();
        let gathered = gather(&mut recorder, probes, &self.source, &buffers, self.gather.bounces)?;
        recorder.submit()?;
        Ok(FrameLight { buffers, gathered: Some(gathered) })
    }

    fn measure_probes(&self) -> Result<ProbeBuffers, GpuError> {
        let settings = ProbeSettings::of(&self.options);
        let directions = fibonacci_sphere(self.gather.directions);
        let AttributeSource { params, layout, .. } = &self.source;
        probes::measure(&self.gpu, params, layout, settings, &directions, self.order)
    }

    /// Renders `wanted`, which is sorted and without repetition, under `light`, which this prepared. A picture whose
    /// G-buffer no binding holds is made band by band.
    ///
    /// # Errors
    /// What went wrong on the device.
    pub fn render(
        &self,
        camera: &RasterCamera,
        light: &FrameLight,
        content: FrameContent,
        wanted: &[Output],
    ) -> Result<Frame, GpuError> {
        let groups = match content {
            FrameContent::Colour => 1,
            FrameContent::GBuffer => groups(self.full()),
        };
        let report = self.gpu.report();
        let row_bytes = (camera.width * groups * 16).max(1) as u64;
        let rows = (report.max_binding.min(report.max_buffer) / row_bytes).max(1) as usize;
        let mut frame =
            Frame { width: camera.width as u32, height: camera.height as u32, planes: BTreeMap::new() };
        for first in (0..camera.height).step_by(rows) {
            let mut band = *camera;
            band.height = rows.min(camera.height - first);
            band.centre_px[1] -= first as f32;
            for (output, mut values) in
                self.render_band(&CameraUniform::new(&band), light, content, wanted)?
            {
                frame.planes.entry(output).or_default().append(&mut values);
            }
        }
        Ok(frame)
    }

    /// All channels of the model.
    fn full(&self) -> Channels {
        Channels::Full(self.source.layout.n_visibility as usize)
    }

    fn render_band(
        &self,
        camera: &CameraUniform,
        light: &FrameLight,
        content: FrameContent,
        wanted: &[Output],
    ) -> Result<Vec<(Output, Vec<f32>)>, GpuError> {
        let mut scratch = locked(&self.scratch);
        let Scratch { raster, planes, .. } = &mut *scratch;
        let source = AttributeSource {
            gathered: light.gathered.clone(),
            indirect_basis: Some(light.buffers.indirect_basis.clone()),
            ..self.source.clone()
        };
        let shading = Shading {
            options: self.options,
            background: [0.0; 3],
            light: light.buffers.clone(),
            constants: self.constants.clone(),
        };
        let projected = raster.prepare(camera, &source)?;
        let recorder = self.gpu.record();
        match content {
            FrameContent::Colour => self.colours(recorder, projected, &shading),
            FrameContent::GBuffer => self.outputs(recorder, projected, shading, planes, wanted),
        }
    }

    /// Coverage and colour from Gaussians that are shaded before they are blended.
    fn colours(
        &self,
        mut recorder: Recorder<'_>,
        projected: Projected<'_>,
        shading: &Shading,
    ) -> Result<Vec<(Output, Vec<f32>)>, GpuError> {
        let shaded =
            projected.attributes(&mut recorder, Channels::Material)?.colours(&mut recorder, shading)?;
        let frame = shaded.blend(&mut recorder, Blending::EarlyStop)?;
        recorder.submit()?;
        let pixels = self.gpu.read(frame.gbuffer(), 0..frame.camera().pixels())?;
        Ok(vec![
            (Output::Rgb, pixels.iter().flat_map(|p| [p[1], p[2], p[3]]).collect()),
            (Output::Alpha, pixels.iter().map(|p| p[0]).collect()),
        ])
    }

    fn outputs(
        &self,
        mut recorder: Recorder<'_>,
        projected: Projected<'_>,
        shading: Shading,
        planes: &mut Option<Planes>,
        wanted: &[Output],
    ) -> Result<Vec<(Output, Vec<f32>)>, GpuError> {
        let pass = FramePass {
            channels: self.full(),
            blending: Blending::EarlyStop,
            branches: Branches::Both(shading.clone()),
        };
        let frame = pass.forward(&mut recorder, projected)?;
        let camera = frame.camera();
        if !planes.as_ref().is_some_and(|p| p.fits(camera.pixels(), wanted)) {
            *planes = None;
        }
        let planes = match planes {
            Some(planes) => planes,
            none => none.insert(Planes::new(&self.gpu, camera.pixels(), wanted)?),
        };
        recorder.stage("resolve");
        planes.resolve(&mut recorder, camera, &shading, frame.gbuffer(), self.depth_scale)?;
        recorder.submit()?;
        planes.read(&self.gpu)
    }
}
