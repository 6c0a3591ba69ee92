//! Frames with light that is traced along rays.

use std::sync::OnceLock;

use crate::gpu::frame::{FrameBranches, FramePass};
use crate::gpu::frames::light::{GpuFrameLight, RestOfLight};
use crate::gpu::light::LightBuffers;
use crate::gpu::rays::{EnvironmentBuffers, Samples, TreeBuffers};
use crate::gpu::resolve::PixelLight;
use crate::{DeviceError, Frame, FrameJob, RayLight, indirect_basis};
use relume_layout::constants::EarlyStop;
use relume_scene::light::{DominantLight, EnvSampler, LightTables, SampleCounts};

/// The value of `cell`, initialised by `make` if empty. When two threads initialise it, one value is dropped.
fn get_or_try_init<T>(
    cell: &OnceLock<T>,
    make: impl FnOnce() -> Result<T, DeviceError>,
) -> Result<&T, DeviceError> {
    if let Some(reused) = cell.get() {
        return Ok(reused);
    }
    let made = make()?;
    Ok(cell.get_or_init(|| made))
}

impl GpuFrameLight {
    /// A frame with the light `rays`, traced along rays.
    pub(super) fn trace(&self, job: &FrameJob<'_>, rays: &RayLight<'_>) -> Result<Frame, DeviceError> {
        let renderer = &self.renderer;
        let tree = get_or_try_init(&renderer.tree, || {
            TreeBuffers::upload(&renderer.gpu, &renderer.host.occluders().tree())
        })?;
        match *rays {
            RayLight::Sharp { lights, rest } => {
                let rest = get_or_try_init(&self.by_rays.rest, || self.upload_rest(rest))?;
                self.under_sharp_lights(job, rest, lights, tree)
            }
            RayLight::Sampled { environment, samples, seed, pixels_before } => {
                let shares = SampleCounts::of(samples, environment);
                self.sampled(job, environment, &Samples { shares, seed, pixels_before }, tree)
            }
        }
    }

    fn upload_rest(&self, rest: &LightTables) -> Result<RestOfLight, DeviceError> {
        let renderer = &self.renderer;
        let buffers = LightBuffers::upload(&renderer.gpu, rest, renderer.sh_degree, &indirect_basis(rest))?;
        let with_sky_shadows = renderer.with_sky_shadows(&self.gathered, &buffers)?;
        Ok(RestOfLight { buffers, with_sky_shadows })
    }

    /// A frame from the tables of the rest, with a traced shadow for each light.
    fn under_sharp_lights(
        &self,
        job: &FrameJob<'_>,
        rest: &RestOfLight,
        lights: &[DominantLight],
        tree: &TreeBuffers,
    ) -> Result<Frame, DeviceError> {
        let renderer = &self.renderer;
        let source = renderer.lit_source(self, &rest.with_sky_shadows);
        let shading = renderer.shading(&rest.buffers);
        let pass = FramePass {
            channels: renderer.full(),
            blending: EarlyStop::WhenSaturated,
            branches: FrameBranches::Both(Box::new(shading.clone())),
        };
        renderer.draw(&job.view, &source, |recorder, projected, reused| {
            let frame = pass.forward(recorder, projected)?;
            let sent = reused.rays.sharp_lights(recorder, &frame, &shading, tree, lights)?;
            let light = (&shading, PixelLight::TablesAnd(&sent));
            renderer.resolved(recorder, frame.camera(), frame.gbuffer(), light, reused.planes, job)
        })
    }

    /// A frame by Monte-Carlo.
    fn sampled(
        &self,
        job: &FrameJob<'_>,
        environment: &EnvSampler,
        samples: &Samples,
        tree: &TreeBuffers,
    ) -> Result<Frame, DeviceError> {
        let renderer = &self.renderer;
        let environment = get_or_try_init(&self.by_rays.environment, || {
            EnvironmentBuffers::upload(&renderer.gpu, environment)
        })?;
        let (source, shading) = (renderer.lit_source(self, &self.gathered), renderer.shading(&self.buffers));
        renderer.draw(&job.view, &source, |recorder, projected, reused| {
            let attributed = projected.attributes(recorder, renderer.full())?;
            let frame = attributed.blend(recorder, EarlyStop::WhenSaturated)?;
            let sent = reused.rays.monte_carlo(recorder, &frame, &shading, tree, environment, samples)?;
            let light = (&shading, PixelLight::Alone(&sent));
            renderer.resolved(recorder, frame.camera(), frame.gbuffer(), light, reused.planes, job)
        })
    }
}
