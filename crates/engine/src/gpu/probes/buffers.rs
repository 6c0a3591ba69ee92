//! Results of a measurement, in device memory.

use crate::DeviceError;
use crate::gpu::model::LayoutUniform;
use crate::gpu::{Buffer, Gpu, Recorder};
use relume_scene::light::sh_eval;
use relume_scene::{Field, sh_count};

/// Measured visibility of a model, in device memory.
#[derive(Debug, Clone)]
pub struct ProbeBuffers {
    /// Number of measured Gaussians.
    pub n: usize,
    /// Coefficients per Gaussian.
    pub n_coefficients: usize,
    /// Unit directions.
    pub directions: Buffer<[f32; 4]>,
    /// Harmonics of each direction, 64 floats, zero beyond the last coefficient.
    pub basis: Buffer<f32>,
    /// Unit normals per Gaussian on the open side, by the visibility field before the measurement.
    pub normals: Buffer<[f32; 4]>,
    /// `[direction][Gaussian]`: transmittance towards the direction, 0..=1.
    pub transmittance: Buffer<f32>,
    /// `[direction][Gaussian]`: the Gaussian that blocks most of the rest, or [`relume_layout::constants::NO_HIT`].
    pub hit: Buffer<u32>,
    /// `[Gaussian][coefficient]`: `4 pi / D sum_d V Y`.
    pub coefficients: Buffer<f32>,
}

/// Floats of a direction's harmonics in the basis buffer, including padding zeros.
const BASIS: usize = 64;

impl ProbeBuffers {
    pub(super) fn empty(
        gpu: &Gpu,
        n: usize,
        directions: &[[f32; 3]],
        sh_degree: usize,
    ) -> Result<Self, DeviceError> {
        let (n_directions, n_coefficients) = (directions.len(), sh_count(sh_degree));
        let mut basis = vec![0.0f32; n_directions * BASIS];
        basis.chunks_exact_mut(BASIS).zip(directions).for_each(|(y, d)| sh_eval(sh_degree, *d, y));
        let by_direction = |what: &str| format!("{what} of {n_directions} directions from {n} Gaussians");
        let flat_directions: Vec<[f32; 4]> = directions.iter().map(|d| padded(*d)).collect();
        Ok(Self {
            n,
            n_coefficients,
            transmittance: gpu.buffer(&by_direction("transmittances"), n * n_directions)?,
            hit: gpu.buffer(&by_direction("hits"), n * n_directions)?,
            directions: gpu.upload("probe directions", &flat_directions)?,
            basis: gpu.upload("probe basis", &basis)?,
            normals: gpu.buffer("outward normals", n)?,
            coefficients: gpu.buffer("visibility coefficients", n * n_coefficients)?,
        })
    }

    /// Replaces the visibility field of the planar `params` by the measured coefficients, which have the field's layout.
    ///
    /// # Errors
    /// [`DeviceError::Misuse`] when the model has another shape.
    pub fn store(
        &self,
        rec: &mut Recorder<'_>,
        params: &Buffer<f32>,
        model: &LayoutUniform,
    ) -> Result<(), DeviceError> {
        let (first, len) = (model.start(Field::Visibility), self.n * self.n_coefficients);
        if (model.n as usize, model.n_visibility as usize) != (self.n, self.n_coefficients)
            || params.len() < first + len
        {
            return Err(DeviceError::Misuse("probes of another model".to_owned()));
        }
        rec.copy(&self.coefficients, 0, params, first, len);
        Ok(())
    }
}

/// Solid angle per direction, sr.
pub(in crate::gpu) fn direction_weight(n_directions: usize) -> f32 {
    4.0 * std::f32::consts::PI / n_directions.max(1) as f32
}

pub(super) fn padded([x, y, z]: [f32; 3]) -> [f32; 4] {
    [x, y, z, 0.0]
}
