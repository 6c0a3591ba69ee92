//! Converts a G-buffer to the requested outputs.

use bytemuck::{Pod, Zeroable};

use crate::DeviceError;
use crate::gpu::permutations::by_coefficients;
use crate::gpu::shading::Shading;
use crate::gpu::{Buffer, CameraUniform, Gpu, ReadbackTicket, Recorder, shaders, uniform};
use relume_scene::Output;

#[cfg(test)]
mod tests;

/// `Resolve` of `shaders/resolve.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct ResolveUniform {
    /// First float of each output, in the order of [`Output`].
    first: [u32; 12],
    depth_scale: f32,
    /// Sources of light, as bits: 1 tables, 2 light traced along rays.
    light: u32,
    pad_a: u32,
    pad_b: u32,
}

/// Source of a frame's light.
#[derive(Debug, Clone, Copy)]
pub enum PixelLight<'a> {
    /// Light tables.
    Tables,
    /// Light tables, plus the given radiance per pixel: diffuse and specular part, planar, times coverage.
    TablesAnd(&'a Buffer<[f32; 4]>),
    /// The given radiance alone.
    Alone(&'a Buffer<[f32; 4]>),
}

/// Outputs of one view in device memory, one after another.
#[derive(Debug, Clone)]
pub struct Planes {
    wanted: Vec<Output>,
    /// First float of each output, and the end.
    first: Vec<usize>,
    values: Buffer<f32>,
    /// Bound in place of missing data.
    nothing: Buffer<[f32; 4]>,
}

impl Planes {
    /// Memory for `wanted` (each at most once) of `pixels` pixels.
    ///
    /// # Errors
    /// [`DeviceError::TooLarge`] with the numbers, [`DeviceError::OutOfMemory`].
    pub fn new(gpu: &Gpu, pixels: usize, wanted: &[Output]) -> Result<Self, DeviceError> {
        let mut first = vec![0];
        let mut end = 0;
        for output in wanted {
            end += output.channels() * pixels;
            first.push(end);
        }
        let (values, nothing) = (gpu.buffer("the outputs", end)?, gpu.buffer("nothing", 1)?);
        Ok(Self { wanted: wanted.to_vec(), first, values, nothing })
    }

    /// True when this is memory for exactly `wanted` of `pixels` pixels.
    pub fn fits(&self, pixels: usize, wanted: &[Output]) -> bool {
        self.wanted == wanted
            && self.values.len() == pixels * wanted.iter().map(|p| p.channels()).sum::<usize>()
    }

    /// Computes the outputs from a full G-buffer, `[group][pixel]`; `depth_scale` turns model units into capture units.
    ///
    /// # Errors
    /// When there is no kernel for the number of visibility coefficients.
    pub fn resolve(
        &self,
        recorder: &mut Recorder<'_>,
        camera: &CameraUniform,
        shading: &Shading,
        gbuffer: &Buffer<[f32; 4]>,
        light: PixelLight<'_>,
        depth_scale: f32,
    ) -> Result<(), DeviceError> {
        use shaders::*;
        let all = [&RESOLVE_1, &RESOLVE_4, &RESOLVE_9, &RESOLVE_16, &RESOLVE_25, &RESOLVE_36, &RESOLVE_49];
        let kernel = by_coefficients(shading.coefficients(), all)?;
        let (light, sent) = match light {
            PixelLight::Tables => (1, &self.nothing),
            PixelLight::TablesAnd(sent) => (3, sent),
            PixelLight::Alone(sent) => (2, sent),
        };
        let mut wanted = ResolveUniform { first: [u32::MAX; 12], depth_scale, light, pad_a: 0, pad_b: 0 };
        for (output, first) in self.wanted.iter().zip(&self.first) {
            wanted.first[*output as usize] = *first as u32;
        }
        let rest = vec![uniform(&wanted), gbuffer.into(), (&self.values).into(), sent.into()];
        shading.dispatch(recorder, camera, kernel, camera.tile_groups(), rest);
        Ok(())
    }

    /// Requests copies of the outputs to the host, in the order of the request.
    pub fn fetch(&self, recorder: &mut Recorder<'_>) -> Vec<(Output, ReadbackTicket<f32>)> {
        let ranges = self.first.windows(2).map(|w| w[0]..w[1]);
        self.wanted.iter().zip(ranges).map(|(p, range)| (*p, recorder.fetch(&self.values, range))).collect()
    }
}
