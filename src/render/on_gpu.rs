//! Frames from the GPU engine.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use crate::engine::channel::Channels;
use crate::engine::gpu::develop::{Plane, Planes};
use crate::engine::gpu::gather::{GatherSource, gather};
use crate::engine::gpu::light::{Constants, LightBuffers};
use crate::engine::gpu::model::LayoutUniform;
use crate::engine::gpu::probes::{ProbeBuffers, Probes};
use crate::engine::gpu::raster::groups;
use crate::engine::gpu::shading::{ShadeJob, ShadingUniform};
use crate::engine::gpu::{AttributeBuffers, Buffer, CameraUniform, Gpu, Raster, grow};
use crate::engine::DeviceError;
use crate::engine::{ProbeSettings, RasterCamera, fibonacci_sphere, indirect_basis};
use crate::light::LightTables;
use crate::render::standard::{BOUNCES, PROBE_DIRECTIONS};
use crate::render::{Frame, Output};
use crate::scene::{Field, IndirectForm, Model, ShadeAt};

/// A light in device memory, with what the model's surfaces send back under it.
pub(super) struct LightOnGpu {
    buffers: LightBuffers,
    gathered: Option<Buffer<f32>>,
}

/// Memory that frames use one after the other.
struct Scratch {
    raster: Raster,
    /// Rows of pictures that are colour alone.
    colours: Option<Buffer<[f32; 4]>>,
    planes: Option<Planes>,
    /// What hides what, once it was needed: it does not depend on the light.
    probes: Option<ProbeBuffers>,
}

/// A model in device memory.
pub(super) struct OnGpu {
    gpu: Gpu,
    layout: LayoutUniform,
    params: Buffer<f32>,
    prototypes: Buffer<f32>,
    constants: Constants,
    order: usize,
    scratch: Mutex<Scratch>,
}

impl OnGpu {
    pub(super) fn new(gpu: &Gpu, model: &Model) -> Result<Self, DeviceError> {
        let scratch = Scratch { raster: Raster::new(gpu)?, colours: None, planes: None, probes: None };
        Ok(Self {
            layout: LayoutUniform::new(&model.gaussians, &model.shading),
            params: gpu.upload_gaussians(&model.gaussians)?,
            prototypes: gpu.upload("prototypes", model.prototypes.as_flattened())?,
            constants: Constants::upload(gpu)?,
            order: model.gaussians.visibility_order(),
            scratch: Mutex::new(scratch),
            gpu: gpu.clone(),
        })
    }

    pub(super) fn prepare_light(&self, model: &Model, tables: &LightTables) -> Result<LightOnGpu, DeviceError> {
        let basis = indirect_basis(tables);
        let buffers = LightBuffers::upload(&self.gpu, tables, self.order, &basis)?;
        if model.shading.indirect != IndirectForm::Gathered {
            return Ok(LightOnGpu { buffers, gathered: None });
        }
        let mut scratch = self.scratch.lock().unwrap_or_else(PoisonError::into_inner);
        if scratch.probes.is_none() {
            let settings = ProbeSettings::of(&model.shading);
            let directions = fibonacci_sphere(PROBE_DIRECTIONS);
            let measured =
                Probes::measure(&self.gpu, &self.params, &self.layout, settings, &directions, self.order)?;
            scratch.probes = Some(measured);
        }
        let Some(probes) = &scratch.probes else { return Ok(LightOnGpu { buffers, gathered: None }) };
        let source = GatherSource {
            params: &self.params,
            model: &self.layout,
            globals: &self.prototypes,
            tables: &buffers.values,
            shape: &buffers.layout,
        };
        let mut recorder = self.gpu.record();
        let gathered = gather(&mut recorder, probes, &source, BOUNCES)?;
        recorder.submit()?;
        Ok(LightOnGpu { buffers, gathered: Some(gathered) })
    }

    /// `wanted` is sorted and without repetition. A picture whose G-buffer no binding holds is made band by band.
    pub(super) fn render(
        &self,
        model: &Model,
        view: &RasterCamera,
        light: &LightOnGpu,
        is_colour: bool,
        wanted: &[Output],
    ) -> Result<Frame, DeviceError> {
        let groups =
            if is_colour { 1 } else { groups(Channels::Full(model.gaussians.width(Field::Visibility))) };
        let report = self.gpu.report();
        let row_bytes = (view.width * groups * 16).max(1) as u64;
        let rows = (report.max_binding.min(report.max_buffer) / row_bytes).max(1) as usize;
        let mut frame =
            Frame { width: view.width as u32, height: view.height as u32, planes: BTreeMap::new() };
        for first in (0..view.height).step_by(rows) {
            let mut band = *view;
            band.height = rows.min(view.height - first);
            band.centre_px[1] -= first as f32;
            let part = self.render_band(model, &CameraUniform::new(&band), light, is_colour, wanted)?;
            for (output, mut values) in part {
                frame.planes.entry(output).or_default().append(&mut values);
            }
        }
        Ok(frame)
    }

    fn render_band(
        &self,
        model: &Model,
        view: &CameraUniform,
        light: &LightOnGpu,
        is_colour: bool,
        wanted: &[Output],
    ) -> Result<BTreeMap<Output, Vec<f32>>, DeviceError> {
        let mut scratch = self.scratch.lock().unwrap_or_else(PoisonError::into_inner);
        let Scratch { raster, colours, planes, .. } = &mut *scratch;
        raster.prepare(view, &self.layout, &self.params)?;
        let n_visibility = model.gaussians.width(Field::Visibility);
        let mut recorder = self.gpu.record();
        let source = AttributeBuffers {
            params: &self.params,
            globals: &self.prototypes,
            gathered: light.gathered.as_ref(),
            indirect_basis: Some(&light.buffers.indirect_basis),
        };
        let shading = ShadingUniform::new(&model.shading, [0.0; 3]);
        let job = ShadeJob {
            view,
            shading: &shading,
            n_visibility,
            light: &light.buffers,
            constants: &self.constants,
        };
        if is_colour {
            raster.attributes(&mut recorder, Channels::Material, &source)?;
            let colours = grow(&self.gpu, "colours", colours, self.layout.n as usize)?;
            raster.light_colours(&mut recorder, &job, &source, &colours)?;
            let rows = raster.attributes.replace(colours);
            raster.blend(&mut recorder, Channels::Colour, true)?;
            raster.attributes = rows;
            recorder.submit()?;
            return self.colour_planes(view, raster);
        }
        let full = Channels::Full(n_visibility);
        raster.attributes(&mut recorder, full, &source)?;
        if model.shading.shade_at == ShadeAt::Gaussian {
            raster.light(&mut recorder, &job, full, &source)?;
        }
        raster.blend(&mut recorder, full, true)?;
        let wanted_planes: Vec<Plane> = wanted.iter().map(|o| plane(*o)).collect();
        if !planes.as_ref().is_some_and(|p| p.fits(view.pixels(), &wanted_planes)) {
            *planes = None;
        }
        let planes = match planes {
            Some(planes) => planes,
            None => planes.insert(Planes::new(&self.gpu, view.pixels(), &wanted_planes)?),
        };
        let Some(gbuffer) = &raster.gbuffer else {
            return Err(DeviceError::Internal("a pass without G-buffer".to_owned()));
        };
        let depth_scale = (1.0 / model.world_scale) as f32;
        recorder.stage("develop");
        planes.develop(&mut recorder, &job, gbuffer, depth_scale)?;
        recorder.submit()?;
        let values = planes.read(&self.gpu)?;
        Ok(wanted.iter().zip(values).map(|(output, (_, values))| (*output, values)).collect())
    }

    /// Coverage and colour of the blended group.
    fn colour_planes(
        &self,
        view: &CameraUniform,
        raster: &Raster,
    ) -> Result<BTreeMap<Output, Vec<f32>>, DeviceError> {
        let Some(gbuffer) = &raster.gbuffer else {
            return Err(DeviceError::Internal("a pass without G-buffer".to_owned()));
        };
        let pixels = self.gpu.read(gbuffer, 0..view.pixels())?;
        Ok(BTreeMap::from([
            (Output::Rgb, pixels.iter().flat_map(|p| [p[1], p[2], p[3]]).collect()),
            (Output::Alpha, pixels.iter().map(|p| p[0]).collect()),
        ]))
    }
}

/// The device's word for an output.
fn plane(output: Output) -> Plane {
    match output {
        Output::Rgb => Plane::Rgb,
        Output::Albedo => Plane::Albedo,
        Output::Normal => Plane::Normal,
        Output::Metallic => Plane::Metallic,
        Output::Roughness => Plane::Roughness,
        Output::Visibility => Plane::Visibility,
        Output::Depth => Plane::Depth,
        Output::Alpha => Plane::Alpha,
        Output::Diffuse => Plane::Diffuse,
        Output::Specular => Plane::Specular,
        Output::Radiance => Plane::Radiance,
    }
}
