//! Rendered frames of a finished model on the device.

use std::collections::BTreeMap;
use std::sync::Mutex;

use rayon::prelude::*;

use crate::engine::channel::Channels;
use crate::engine::constants::EarlyStop;
use crate::engine::gpu::frame::{FrameBranches, FramePass};
use crate::engine::gpu::gather::{LightProbes, gather, ungathered};
use crate::engine::gpu::light::{Constants, LightBuffers};
use crate::engine::gpu::lock::locked;
use crate::engine::gpu::model::LayoutUniform;
use crate::engine::gpu::permutations::groups;
use crate::engine::gpu::probes::{self, ProbeBuffers};
use crate::engine::gpu::raster::{Projected, Raster};
use crate::engine::gpu::resolve::Planes;
use crate::engine::gpu::shading::Shading;
use crate::engine::gpu::{Arrival, AttributeSource, Buffer, CameraUniform, Gpu, Recorder, Ticket};
use crate::engine::{
    BOUNCES, DeviceError, DeviceFrames, DeviceLight, Frame, FrameJob, Output, PROBE_DIRECTIONS,
    ProbeSettings, ShadeColour, fibonacci_sphere, indirect_basis,
};
use crate::light::LightTables;
use crate::scene::{IndirectForm, Model, ShadingOptions, SplitLight};

/// Fewest pixels of a frame that a thread takes apart.
const SPLIT: usize = 1 << 14;

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
    constants: Constants,
    scratch: Mutex<Scratch>,
}

impl Frames {
    /// Uploads `model`.
    ///
    /// # Errors
    /// [`DeviceError::TooLarge`] or [`DeviceError::OutOfMemory`] when it does not fit.
    pub fn new(gpu: &Gpu, model: &Model) -> Result<Self, DeviceError> {
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
            constants: Constants::upload(gpu)?,
            scratch: Mutex::new(Scratch { raster: Raster::new(gpu)?, planes: None, probes: None }),
            gpu: gpu.clone(),
        })
    }

    fn measure_probes(&self) -> Result<ProbeBuffers, DeviceError> {
        let settings = ProbeSettings::of(&self.options);
        let directions = fibonacci_sphere(PROBE_DIRECTIONS);
        let AttributeSource { params, layout, .. } = &self.source;
        probes::measure(&self.gpu, params, layout, settings, &directions, self.order)
    }

    /// All channels of the model.
    fn full(&self) -> Channels {
        Channels::Full(self.source.layout.n_visibility as usize)
    }

    fn render_band(
        &self,
        camera: &CameraUniform,
        light: &FrameLight,
        job: &FrameJob<'_>,
    ) -> Result<Vec<(Output, Vec<f32>)>, DeviceError> {
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
        loop {
            let mut recorder = self.gpu.record();
            let projected = raster.record(&mut recorder, camera, &source)?;
            let listed = recorder.fetch(projected.listed(), 0..projected.listed().len());
            let drawn = match job.colour {
                ShadeColour::Alone => self.colours(&mut recorder, projected, &shading)?,
                ShadeColour::WithGBuffer => self.outputs(&mut recorder, projected, &shading, planes, job)?,
            };
            let arrival = recorder.submit()?.arrive()?;
            if raster.settle(&arrival.read(&listed)?)? {
                return drawn.planes(&arrival);
            }
        }
    }

    /// Coverage and colour from Gaussians that are shaded before they are blended.
    fn colours(
        &self,
        recorder: &mut Recorder<'_>,
        projected: Projected<'_>,
        shading: &Shading,
    ) -> Result<Drawn, DeviceError> {
        let shaded = projected.attributes(recorder, Channels::Material)?.colours(recorder, shading)?;
        let frame = shaded.blend(recorder, EarlyStop::WhenSaturated)?;
        let pixels = frame.camera().pixels();
        Ok(Drawn::Colours(recorder.fetch(frame.gbuffer(), 0..pixels)))
    }

    fn outputs(
        &self,
        recorder: &mut Recorder<'_>,
        projected: Projected<'_>,
        shading: &Shading,
        planes: &mut Option<Planes>,
        job: &FrameJob<'_>,
    ) -> Result<Drawn, DeviceError> {
        let pass = FramePass {
            channels: self.full(),
            blending: EarlyStop::WhenSaturated,
            branches: FrameBranches::Both(Box::new(shading.clone())),
        };
        let frame = pass.forward(recorder, projected)?;
        let camera = frame.camera();
        if !planes.as_ref().is_some_and(|p| p.fits(camera.pixels(), job.outputs)) {
            *planes = None;
        }
        let planes = match planes {
            Some(planes) => planes,
            none => none.insert(Planes::new(&self.gpu, camera.pixels(), job.outputs)?),
        };
        recorder.stage("resolve");
        planes.resolve(recorder, camera, shading, frame.gbuffer(), job.depth_scale)?;
        Ok(Drawn::Outputs(planes.fetch(recorder)))
    }
}

/// What a submission brings back of a frame.
enum Drawn {
    /// Coverage and colour of each pixel.
    Colours(Ticket<[f32; 4]>),
    /// Each output by itself.
    Outputs(Vec<(Output, Ticket<f32>)>),
}

impl Drawn {
    fn planes(self, arrival: &Arrival) -> Result<Vec<(Output, Vec<f32>)>, DeviceError> {
        match self {
            Self::Colours(pixels) => arrival.with(&pixels, |pixels: &[[f32; 4]]| {
                let (mut rgb, mut alpha) = (vec![[0.0; 3]; pixels.len()], vec![0.0; pixels.len()]);
                pixels.par_iter().zip(&mut rgb).zip(&mut alpha).with_min_len(SPLIT).for_each(
                    |((pixel, rgb), alpha)| {
                        let [a, r, g, b] = *pixel;
                        (*alpha, *rgb) = (a, [r, g, b]);
                    },
                );
                vec![(Output::Rgb, rgb.into_flattened()), (Output::Alpha, alpha)]
            }),
            Self::Outputs(planes) => {
                planes.into_iter().map(|(output, values)| Ok((output, arrival.read(&values)?))).collect()
            }
        }
    }
}

impl DeviceFrames for Frames {
    fn prepare_light(&self, tables: &LightTables) -> Result<DeviceLight, DeviceError> {
        let buffers = LightBuffers::upload(&self.gpu, tables, self.order, &indirect_basis(tables))?;
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
            return Ok(Box::new(FrameLight { buffers, gathered: arriving }));
        }
        let probes = match &mut scratch.probes {
            Some(probes) => probes,
            none => none.insert(self.measure_probes()?),
        };
        let mut recorder = self.gpu.record();
        let gathered = gather(&mut recorder, probes, &self.source, &buffers, BOUNCES, lights.as_ref())?;
        recorder.submit()?;
        Ok(Box::new(FrameLight { buffers, gathered: Some(gathered) }))
    }

    /// A picture whose G-buffer no binding holds is made band by band.
    fn render(&self, job: &FrameJob<'_>, light: &DeviceLight) -> Result<Frame, DeviceError> {
        let Some(light) = light.downcast_ref::<FrameLight>() else {
            return Err(DeviceError::Misuse("the light was prepared for another device".to_owned()));
        };
        let camera = &job.view;
        let groups = match job.colour {
            ShadeColour::Alone => 1,
            ShadeColour::WithGBuffer => groups(self.full()),
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
            for (output, mut values) in self.render_band(&CameraUniform::new(&band), light, job)? {
                frame.planes.entry(output).or_default().append(&mut values);
            }
        }
        Ok(frame)
    }
}
