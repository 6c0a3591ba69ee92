//! Interface between a renderer and an engine: a model on a device, lights prepared for it, and frames shaded from light
//! tables.

use std::sync::{Arc, OnceLock};

use crate::frame_job::{DeviceLight, DeviceRenderer, FrameJob};
use crate::{DeviceError, Frame, RayLight, cpu};
use relume_scene::light::{LightTables, rendering_tables, split_tables, tables_of_split};
use relume_scene::{Illumination, Model, ShadeAt};

/// A model on its device. The CPU engine always holds the model as well, for computations on the host.
pub struct FrameRenderer {
    cpu: cpu::CpuFrameRenderer,
    device: Option<Box<dyn DeviceRenderer>>,
}

/// A light prepared for a model on its device.
pub struct FrameLight {
    device: Option<DeviceLight>,
    cpu: OnceLock<cpu::CpuFrameLight>,
}

impl FrameLight {
    /// The light on the CPU engine; `None` where another device prepared it.
    pub fn on_cpu(&self) -> Option<&cpu::CpuFrameLight> {
        self.cpu.get()
    }
}

impl FrameRenderer {
    /// Prepares a checked model for the CPU engine.
    pub fn on_cpu_only(model: Arc<Model>) -> Self {
        Self { cpu: cpu::CpuFrameRenderer::new(model), device: None }
    }

    /// Wraps a checked model that `device` holds as well.
    pub fn beside(model: Arc<Model>, device: Box<dyn DeviceRenderer>) -> Self {
        Self { cpu: cpu::CpuFrameRenderer::new(model), device: Some(device) }
    }

    /// The model.
    pub fn model(&self) -> &Model {
        self.cpu.model()
    }

    /// True when a device other than the CPU engine holds the model.
    pub fn has_device(&self) -> bool {
        self.device.is_some()
    }

    /// The same model on the CPU engine.
    pub fn on_cpu(&self) -> &cpu::CpuFrameRenderer {
        &self.cpu
    }

    /// Prepares `light` for this model, including interreflection between its surfaces.
    ///
    /// # Errors
    /// When the device failed.
    pub fn prepare_light(&self, light: &Illumination) -> Result<FrameLight, DeviceError> {
        let tables = self.tables(light);
        Ok(match &self.device {
            Some(device) => FrameLight { device: Some(device.prepare_light(&tables)?), cpu: OnceLock::new() },
            None => FrameLight { device: None, cpu: OnceLock::from(self.cpu.prepare_light(tables)) },
        })
    }

    /// The light on the CPU engine; computed from `source` where another device prepared it.
    pub fn light_on_cpu<'a>(&self, light: &'a FrameLight, source: &Illumination) -> &'a cpu::CpuFrameLight {
        light.cpu.get_or_init(|| self.cpu.prepare_light(self.tables(source)))
    }

    /// Renders on the device.
    ///
    /// # Errors
    /// [`DeviceError::Misuse`] for a light of another device, otherwise when the device failed.
    pub fn render(&self, job: &FrameJob<'_>, light: &FrameLight) -> Result<Frame, DeviceError> {
        match (&self.device, &light.device, light.cpu.get()) {
            (Some(device), Some(light), _) => device.render(job, light),
            (None, None, Some(light)) => Ok(self.cpu.render(job, light)),
            _ => Err(DeviceError::Misuse("the light was prepared for another device".to_owned())),
        }
    }

    /// Renders on the device with light that is traced along rays. `rays` must belong to the environment from which `light` was
    /// prepared.
    ///
    /// # Errors
    /// As [`Self::render`].
    pub fn render_by_rays(
        &self,
        job: &FrameJob<'_>,
        light: &FrameLight,
        rays: &RayLight<'_>,
    ) -> Result<Frame, DeviceError> {
        match (&self.device, &light.device, light.cpu.get()) {
            (Some(device), Some(light), _) => {
                device.render_by_rays(job, light, rays, &|| self.cpu.occluders().tree())
            }
            (None, None, Some(light)) => Ok(self.cpu.render_by_rays(job, light, rays)),
            _ => Err(DeviceError::Misuse("the light was prepared for another device".to_owned())),
        }
    }

    /// Tables of the environment and, for models shaded at their Gaussians, its dominant lights.
    fn tables(&self, light: &Illumination) -> LightTables {
        let (environment, sh_degree) = (&light.environment, self.model().gaussians.visibility_degree());
        match (self.model().shading.shade_at, &light.split) {
            (ShadeAt::Pixel, _) => rendering_tables(environment, sh_degree),
            (ShadeAt::Gaussian, Some(split)) => tables_of_split(environment, split, sh_degree),
            (ShadeAt::Gaussian, None) => split_tables(environment, sh_degree),
        }
    }
}
