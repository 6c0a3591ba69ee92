//! Frames with light that is traced along rays.

use std::sync::OnceLock;

use crate::gpu::frame::{FrameBranches, FramePass};
use crate::gpu::frames::GpuFrameRenderer;
use crate::gpu::frames::light::GpuFrameLight;
use crate::gpu::light::LightBuffers;
use crate::gpu::permutations::groups;
use crate::gpu::rays::{EnvironmentBuffers, Samples, TreeBuffers};
use crate::gpu::resolve::PixelLight;
use crate::{DeviceError, Frame, FrameJob, RasterCamera, RayLight, RayTree, indirect_basis};
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

impl GpuFrameRenderer {
    /// A frame with the light `rays`, traced along rays.
    pub(super) fn trace(
        &self,
        job: &FrameJob<'_>,
        light: &GpuFrameLight,
        rays: &RayLight<'_>,
        tree: &dyn Fn() -> RayTree,
    ) -> Result<Frame, DeviceError> {
        let tree = get_or_try_init(&self.tree, || TreeBuffers::upload(&self.gpu, &tree()))?;
        match *rays {
            RayLight::Sharp { lights, rest } => {
                let rest = get_or_try_init(&light.by_rays.rest, || self.upload_rest(rest))?;
                self.under_sharp_lights(job, light, rest, lights, tree)
            }
            RayLight::Sampled { environment, samples, seed, pixels_before } => {
                let shares = SampleCounts::of(samples, environment);
                self.sampled(job, light, environment, Samples { shares, seed, pixels_before }, tree)
            }
        }
    }

    fn upload_rest(&self, rest: &LightTables) -> Result<LightBuffers, DeviceError> {
        LightBuffers::upload(&self.gpu, rest, self.sh_degree, &indirect_basis(rest))
    }

    /// A frame from the tables of the rest, with a traced shadow for each light.
    fn under_sharp_lights(
        &self,
        job: &FrameJob<'_>,
        light: &GpuFrameLight,
        rest: &LightBuffers,
        lights: &[DominantLight],
        tree: &TreeBuffers,
    ) -> Result<Frame, DeviceError> {
        let (source, shading) = (self.lit_source(light), self.shading(rest));
        let pass = FramePass {
            channels: self.full(),
            blending: EarlyStop::WhenSaturated,
            branches: FrameBranches::Both(Box::new(shading.clone())),
        };
        self.in_bands(&job.view, groups(self.full()), |band, _| {
            self.draw(band, &source, |recorder, projected, reused| {
                let frame = pass.forward(recorder, projected)?;
                let sent = reused.rays.sharp_lights(recorder, &frame, &self.options, tree, lights)?;
                let light = (&shading, PixelLight::TablesAnd(&sent));
                self.resolved(recorder, frame.camera(), frame.gbuffer(), light, reused.planes, job)
            })
        })
    }

    /// A frame by Monte-Carlo.
    fn sampled(
        &self,
        job: &FrameJob<'_>,
        light: &GpuFrameLight,
        environment: &EnvSampler,
        samples: Samples,
        tree: &TreeBuffers,
    ) -> Result<Frame, DeviceError> {
        let environment = get_or_try_init(&light.by_rays.environment, || {
            EnvironmentBuffers::upload(&self.gpu, environment)
        })?;
        let (source, shading) = (self.lit_source(light), self.shading(&light.buffers));
        let of_band = |band: &RasterCamera, first: usize| {
            let pixels_before = samples.pixels_before + (first * band.width) as u64;
            let samples = Samples { pixels_before, ..samples };
            self.draw(band, &source, |recorder, projected, reused| {
                let attributed = projected.attributes(recorder, self.full())?;
                let frame = attributed.blend(recorder, EarlyStop::WhenSaturated)?;
                let sent = reused.rays.monte_carlo(recorder, &frame, tree, environment, &samples)?;
                let light = (&shading, PixelLight::Alone(&sent));
                self.resolved(recorder, frame.camera(), frame.gbuffer(), light, reused.planes, job)
            })
        };
        self.in_bands(&job.view, groups(self.full()), of_band)
    }
}
