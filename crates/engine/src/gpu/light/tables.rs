//! Light tables for shading, in device memory.

use bytemuck::{Pod, Zeroable};

use crate::DeviceError;
use crate::gpu::{Buffer, Gpu};
use relume_scene::light::{CubeGrid, LightTables, reflectance_tables};
use relume_scene::{MAX_LIGHTS, sh_count};

/// The tables of the reflectance model ([`reflectance_tables`]), uploaded once per device.
#[derive(Debug, Clone)]
pub struct Constants {
    pub(in crate::gpu) buffer: Buffer<f32>,
}

impl Constants {
    /// Uploads the tables, which all engines share.
    ///
    /// # Errors
    /// When the device has no memory left.
    pub fn upload(gpu: &Gpu) -> Result<Self, DeviceError> {
        Ok(Self { buffer: gpu.upload("reflectance tables", &reflectance_tables())? })
    }
}

/// `Tables` of `shaders/shared/tables.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct TablesUniform {
    /// Nodes along an edge of the grid of normals.
    pub diffuse_n: u32,
    /// Padded number of coefficients per colour.
    pub coefficients: u32,
    /// Number of coefficients in use.
    pub n_coefficients: u32,
    /// Number of nodes of all levels.
    pub n_specular: u32,
    /// Nodes along an edge, per level; the last two are unused.
    pub specular_n: [u32; 8],
    /// First float, per level; the last two are unused.
    pub specular_first: [u32; 8],
    /// Number of dominant lights.
    pub n_lights: u32,
    /// First float of the lights' irradiance.
    pub first_light: u32,
    /// Unused.
    pub pad_a: u32,
    /// Unused.
    pub pad_b: u32,
    /// Unit direction and angular radius of each light.
    pub lights: [[f32; 4]; MAX_LIGHTS],
}

impl TablesUniform {
    /// Layout of `tables`, for a visibility field of degree `sh_degree`, in one buffer.
    pub fn new(tables: &LightTables, sh_degree: usize) -> Self {
        let edge = |grid: &CubeGrid| grid.edge() as u32;
        let mut out = Self {
            diffuse_n: edge(&tables.diffuse_grid),
            coefficients: tables.coefficients as u32,
            n_coefficients: sh_count(sh_degree) as u32,
            ..Self::zeroed()
        };
        let mut next = tables.diffuse.len() as u32;
        for (k, (grid, level)) in tables.specular_grids.iter().zip(&tables.specular).enumerate() {
            out.specular_n[k] = edge(grid);
            out.specular_first[k] = next;
            out.n_specular += level.len() as u32;
            next += 3 * level.len() as u32;
        }
        out.n_lights = tables.lights.len().min(MAX_LIGHTS) as u32;
        out.first_light = next;
        for (row, light) in out.lights.iter_mut().zip(&tables.lights) {
            let [x, y, z] = light.direction;
            *row = [x, y, z, light.radius];
        }
        out
    }

    /// Number of floats of the whole buffer.
    pub fn floats(&self) -> usize {
        self.first_light as usize + 3 * MAX_LIGHTS
    }
}

/// The tables of one light in device memory.
#[derive(Debug, Clone)]
pub struct LightBuffers {
    /// Layout of the tables.
    pub layout: TablesUniform,
    /// The tables.
    pub values: Buffer<f32>,
    /// `E_j` of Eq. 20, `[16][3]`.
    pub indirect_basis: Buffer<f32>,
}

impl LightBuffers {
    /// Uploads finished tables.
    ///
    /// # Errors
    /// When they do not fit.
    pub fn upload(
        gpu: &Gpu,
        tables: &LightTables,
        sh_degree: usize,
        indirect_basis: &[[f32; 3]; 16],
    ) -> Result<Self, DeviceError> {
        Ok(Self {
            layout: TablesUniform::new(tables, sh_degree),
            values: gpu.upload("light tables", &tables.flat())?,
            indirect_basis: gpu.upload("indirect basis", indirect_basis.as_flattened())?,
        })
    }
}
