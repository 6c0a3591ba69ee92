//! From a G-buffer to the pictures that were asked for.

use bytemuck::{Pod, Zeroable};

use crate::engine::gpu::shading::{ShadeJob, by_coefficients};
use crate::engine::gpu::{Buffer, Gpu, GpuError, Recorder, shaders, uniform};

#[cfg(test)]
mod tests;

/// A picture that can be developed, in the order of `develop.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(usize)]
pub enum Plane {
    /// Relit linear radiance, premultiplied by coverage (3).
    Rgb = 0,
    /// Linear base colour (3).
    Albedo = 1,
    /// World-space unit normal; zero where nothing is (3).
    Normal = 2,
    /// Metalness (1).
    Metallic = 3,
    /// Roughness (1).
    Roughness = 4,
    /// Ambient occlusion, 1 = open (1).
    Visibility = 5,
    /// Distance along the view axis, capture units; infinite where nothing is (1).
    Depth = 6,
    /// Coverage (1).
    Alpha = 7,
    /// Diffuse part of `Rgb`, premultiplied (3).
    Diffuse = 8,
    /// Specular part of `Rgb`, premultiplied (3).
    Specular = 9,
    /// The radiance branch, linear, premultiplied (3).
    Radiance = 10,
}

impl Plane {
    /// Floats a pixel.
    pub fn channels(self) -> usize {
        match self {
            Self::Metallic | Self::Roughness | Self::Visibility | Self::Depth | Self::Alpha => 1,
            _ => 3,
        }
    }
}

/// `Develop` of `shaders/develop.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct DevelopUniform {
    first: [u32; 12],
    depth_scale: f32,
    pad_a: u32,
    pad_b: u32,
    pad_c: u32,
}

/// Pictures of one view in device memory, one after another.
#[derive(Debug, Clone)]
pub struct Planes {
    wanted: Vec<Plane>,
    /// First float of each wanted plane, and the end.
    first: Vec<usize>,
    values: Buffer<f32>,
}

impl Planes {
    /// Room for `wanted` (each at most once) of `pixels` pixels.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] with the numbers, [`GpuError::OutOfMemory`].
    pub fn new(gpu: &Gpu, pixels: usize, wanted: &[Plane]) -> Result<Self, GpuError> {
        let mut first = vec![0];
        let mut end = 0;
        for plane in wanted {
            end += plane.channels() * pixels;
            first.push(end);
        }
        Ok(Self { wanted: wanted.to_vec(), first, values: gpu.buffer("the pictures", end)? })
    }

    /// True when this is room for exactly `wanted` of `pixels` pixels.
    pub fn fits(&self, pixels: usize, wanted: &[Plane]) -> bool {
        self.wanted == wanted
            && self.values.len() == pixels * wanted.iter().map(|p| p.channels()).sum::<usize>()
    }

    /// Develops a full G-buffer, `[group][pixel]`; `depth_scale` turns model units into capture units.
    ///
    /// # Errors
    /// When there is no kernel for the number of visibility coefficients.
    pub fn develop(
        &self,
        recorder: &mut Recorder<'_>,
        job: &ShadeJob<'_>,
        gbuffer: &Buffer<[f32; 4]>,
        depth_scale: f32,
    ) -> Result<(), GpuError> {
        use shaders::*;
        let all = [&DEVELOP_1, &DEVELOP_4, &DEVELOP_9, &DEVELOP_16, &DEVELOP_25, &DEVELOP_36, &DEVELOP_49];
        let shader = by_coefficients(job.n_visibility, all)?;
        let mut wanted = DevelopUniform { first: [u32::MAX; 12], depth_scale, pad_a: 0, pad_b: 0, pad_c: 0 };
        for (plane, first) in self.wanted.iter().zip(&self.first) {
            wanted.first[*plane as usize] = *first as u32;
        }
        job.dispatch(
            recorder,
            shader,
            job.tiles(),
            vec![uniform(&wanted), gbuffer.into(), (&self.values).into()],
        );
        Ok(())
    }

    /// Copies the pictures to the host, in the order they were asked for; waits for the device.
    ///
    /// # Errors
    /// Whatever went wrong on the device meanwhile.
    pub fn read(&self, gpu: &Gpu) -> Result<Vec<(Plane, Vec<f32>)>, GpuError> {
        let values = gpu.read(&self.values, 0..self.values.len())?;
        let ranges = self.first.windows(2).map(|w| w[0]..w[1]);
        Ok(self.wanted.iter().zip(ranges).map(|(p, range)| (*p, values[range].to_vec())).collect())
    }
}
