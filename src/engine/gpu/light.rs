//! Light in device memory: the tables a pixel looks up and the constants of the reflectance model.

use bytemuck::{Pod, Zeroable};

use crate::engine::cpu;
use crate::engine::gpu::{Buffer, Gpu, GpuError};
use crate::light::{BrdfLut, CubeGrid, LightTables, LobeAttenuation, SPECULAR_LEVELS};

/// The split-sum table and the lobe rows, uploaded once a device: 2,048 floats `[roughness][n.v][scale, bias]`, then
/// 33 x 9 attenuations.
#[derive(Debug, Clone)]
pub struct Constants {
    pub(super) buffer: Buffer<f32>,
}

impl Constants {
    /// Uploads the tables that all engines share.
    ///
    /// # Errors
    /// When the device has no memory left.
    pub fn upload(gpu: &Gpu) -> Result<Self, GpuError> {
        let lut = BrdfLut::shared().values().iter().flatten();
        let lobe = LobeAttenuation::shared().rows().iter().flatten();
        let values: Vec<f32> = lut.chain(lobe).copied().collect();
        Ok(Self { buffer: gpu.upload("reflectance tables", &values)? })
    }
}

/// `Tables` of `shaders/shared/light_tables.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct TablesUniform {
    /// Nodes along an edge of the grid of normals.
    pub diffuse_n: u32,
    /// Coefficients a row has, padding included.
    pub coefficients: u32,
    /// Coefficients that can differ from zero.
    pub n_coefficients: u32,
    /// Unused.
    pub pad: u32,
    /// Nodes along an edge, per level; the last two are unused.
    pub specular_n: [u32; 8],
    /// First float of each level; the last two are unused.
    pub specular_first: [u32; 8],
}

impl TablesUniform {
    /// Where tables over these grids lie.
    pub fn new(diffuse: CubeGrid, specular: &[CubeGrid; SPECULAR_LEVELS.len()], coefficients: usize) -> Self {
        let (mut specular_n, mut specular_first) = ([2u32; 8], [0u32; 8]);
        let mut next = diffuse.len() * 3 * coefficients;
        for (k, grid) in specular.iter().enumerate() {
            specular_n[k] = grid.edge() as u32;
            specular_first[k] = next as u32;
            next += 3 * grid.len();
        }
        Self {
            diffuse_n: diffuse.edge() as u32,
            coefficients: coefficients as u32,
            n_coefficients: coefficients as u32,
            pad: 0,
            specular_n,
            specular_first,
        }
    }

    /// Floats of the tables, a multiple of four.
    pub fn floats(&self) -> usize {
        let (last, edge) = (SPECULAR_LEVELS.len() - 1, self.specular_n[SPECULAR_LEVELS.len() - 1] as usize);
        (self.specular_first[last] as usize + 18 * edge * edge).next_multiple_of(4)
    }
}

/// All floats of `tables` in the device's order.
pub fn flat(tables: &LightTables) -> Vec<f32> {
    let specular = tables.specular.iter().flatten().flatten();
    let mut out: Vec<f32> = tables.diffuse.iter().chain(specular).copied().collect();
    out.resize(out.len().next_multiple_of(4), 0.0);
    out
}

/// Light tables in device memory.
#[derive(Debug, Clone)]
pub struct LightBuffers {
    /// Where their parts lie.
    pub uniform: TablesUniform,
    /// Diffuse transfer, then specular levels.
    pub tables: Buffer<f32>,
    /// `E_j` of Eq. 20, `[16][3]`.
    pub indirect_basis: Buffer<f32>,
}

impl LightBuffers {
    /// Uploads finished tables, e.g. those of a posted map.
    ///
    /// # Errors
    /// When the device has no memory left.
    pub fn upload(gpu: &Gpu, tables: &LightTables) -> Result<Self, GpuError> {
        let uniform = TablesUniform::new(tables.diffuse_grid, &tables.specular_grids, tables.coefficients);
        let basis: Vec<f32> = cpu::indirect_basis(tables).into_iter().flatten().collect();
        Ok(Self {
            uniform,
            tables: gpu.upload("light tables", &flat(tables))?,
            indirect_basis: gpu.upload("indirect basis", &basis)?,
        })
    }
}
