//! Monte-Carlo estimate of the light of a whole environment in every pixel.

use bytemuck::{Pod, Zeroable};

use crate::DeviceError;
use crate::gpu::grow::grow;
use crate::gpu::raster::Blended;
use crate::gpu::rays::{RayMemory, TreeBuffers};
use crate::gpu::shading::Shading;
use crate::gpu::{Buffer, Gpu, Recorder, shaders, uniform};
use relume_scene::light::{EnvSampler, SampleCounts};

/// Maximum number of samples per dispatch. A device that also drives a display must not be busy for long, and Mesa's software
/// drivers end a thread's loops after 65,535 iterations, which here are visited boxes.
const MAX_SAMPLES_PER_DISPATCH: u32 = 8;

/// `MonteCarlo` of `shaders/monte_carlo.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct MonteCarloUniform {
    seed: [u32; 2],
    pixels_before: u32,
    first_sample: u32,
    end_sample: u32,
    n_light: u32,
    n_cosine: u32,
    n_lobe: u32,
    width: u32,
    height: u32,
    conserves_energy: u32,
    pad: u32,
}

/// An [`EnvSampler`] in device memory.
#[derive(Debug, Clone)]
pub struct EnvironmentBuffers {
    width: u32,
    height: u32,
    texels: Buffer<[f32; 4]>,
    sums: Buffer<f32>,
}

impl EnvironmentBuffers {
    /// Uploads `sampler`.
    ///
    /// # Errors
    /// When it does not fit.
    pub fn upload(gpu: &Gpu, sampler: &EnvSampler) -> Result<Self, DeviceError> {
        let tables = sampler.tables();
        Ok(Self {
            width: tables.width as u32,
            height: tables.height as u32,
            texels: gpu.upload("texels to draw from", &tables.texels)?,
            sums: gpu.upload("sums of texels", &tables.sums)?,
        })
    }
}

/// Samples of a view.
#[derive(Debug, Clone, Copy)]
pub struct Samples {
    /// Number of samples per density.
    pub shares: SampleCounts,
    /// Seed of all samples.
    pub seed: u64,
    /// Number of pixels of the frame before the view's first pixel.
    pub pixels_before: u64,
}

impl RayMemory {
    /// Reflection of `environment` in each pixel of a full frame of unshaded Gaussians: diffuse and specular radiance, planar,
    /// times coverage.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn monte_carlo(
        &mut self,
        recorder: &mut Recorder<'_>,
        frame: &Blended<'_>,
        shading: &Shading,
        tree: &TreeBuffers,
        environment: &EnvironmentBuffers,
        samples: &Samples,
    ) -> Result<Buffer<[f32; 4]>, DeviceError> {
        let depths = self.surface_depths(recorder, frame)?;
        let camera = frame.camera();
        let sent = grow(recorder.gpu(), "light sent", &mut self.sent, 2 * camera.pixels())?;
        let Samples { shares, seed, pixels_before } = *samples;
        let all = shares.light + shares.cosine + shares.lobe;
        for first in (0..all).step_by(MAX_SAMPLES_PER_DISPATCH as usize) {
            let sampling = MonteCarloUniform {
                seed: [seed as u32, (seed >> 32) as u32],
                pixels_before: pixels_before as u32,
                first_sample: first,
                end_sample: all.min(first + MAX_SAMPLES_PER_DISPATCH),
                n_light: shares.light,
                n_cosine: shares.cosine,
                n_lobe: shares.lobe,
                width: environment.width,
                height: environment.height,
                conserves_energy: u32::from(shading.options.conserves_energy),
                pad: 0,
            };
            let bindings = [
                uniform(camera),
                uniform(&sampling),
                uniform(&tree.rules),
                frame.gbuffer().into(),
                (&depths).into(),
                (&tree.nodes).into(),
                (&tree.members).into(),
                (&environment.texels).into(),
                (&environment.sums).into(),
                (&shading.constants.buffer).into(),
                (&sent).into(),
            ];
            recorder.stage("monte carlo");
            recorder.dispatch(&shaders::MONTE_CARLO, camera.tile_groups(), &bindings);
        }
        Ok(sent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::shaders::assert_layout;

    #[test]
    fn samples_are_laid_out_as_the_shader_reads_them() {
        assert_layout!(
            MonteCarloUniform as "MonteCarlo" in shaders::MONTE_CARLO;
            seed, pixels_before, first_sample, end_sample, n_light, n_cosine, n_lobe, width, height, conserves_energy, pad
        );
    }
}
