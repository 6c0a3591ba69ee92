//! The environment of a training: its tables by linear operators, and their gradient by the transposed ones.

use bytemuck::{Pod, Zeroable};

use crate::gpu::light::tables::LightBuffers;
use crate::gpu::model::ModelBuffers;
use crate::gpu::{Buffer, Gpu, Groups, Recorder, shaders, uniform};
use crate::indirect::INDIRECT_DIRECTIONS;
use crate::{DeviceError, LightWeights, TurnedLight, fibonacci_sphere};
use relume_scene::light::{EnvOperators, LightTables, sh_eval};
use relume_scene::{ColumnShift, IndirectForm, texel_directions};

/// `Environment` of `shaders/shared/environment.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub(super) struct EnvironmentUniform {
    pub(super) n_texels: u32,
    pub(super) first_texel: u32,
    pub(super) neutrality: f32,
    pub(super) exposure: f32,
    pub(super) colour: f32,
    pub(super) blue_over_red: f32,
    pub(super) green: f32,
    pub(super) tolerance: f32,
    pub(super) width: u32,
    pub(super) whole: u32,
    pub(super) fraction: f32,
}

/// The environment operators of a training, with the light they were last applied to and the gradient of its tables.
#[derive(Debug, Clone)]
pub struct TrainingLight {
    /// The tables of the light at the last [`TrainingLight::apply`].
    pub light: LightBuffers,
    /// Gradient of the tables; [`TrainingLight::apply`] clears it, the shading adds to it.
    pub tables_gradient: Buffer<f32>,
    /// Gradient of the indirect basis, handled the same way.
    pub basis_gradient: Buffer<f32>,
    radiance: Buffer<f32>,
    /// The radiance, rotated as in the photograph.
    turned: Buffer<f32>,
    by_sky_light: Buffer<f32>,
    rows: [Buffer<u32>; 2],
    entries: [Buffer<[u32; 2]>; 2],
    harmonics: Buffer<f32>,
    upward: Buffer<f32>,
    reading: Buffer<f32>,
    /// Columns and rows of the environment.
    size: (usize, usize),
}

impl TrainingLight {
    /// Uploads the operators.
    ///
    /// # Errors
    /// When they do not fit.
    pub fn new(gpu: &Gpu, operators: &EnvOperators) -> Result<Self, DeviceError> {
        let tables = operators.shape();
        let light = LightBuffers::upload(gpu, &tables, operators.sh_degree(), &[[0.0; 3]; 16])?;
        let (forward, backward) = (operators.rows(), operators.transposed_rows());
        let (width, height) = operators.size();
        let upward: Vec<f32> = texel_directions(width, height)
            .iter()
            .map(|(d, w)| (d.z.max(0.0) * w / std::f64::consts::PI) as f32)
            .collect();
        Ok(Self {
            tables_gradient: gpu.buffer("gradient of the light tables", light.values.len())?,
            basis_gradient: gpu.buffer("gradient of the indirect basis", 48)?,
            radiance: gpu.buffer("radiance", 3 * width * height)?,
            turned: gpu.buffer("turned radiance", 3 * width * height)?,
            by_sky_light: gpu.buffer("derivative by the light from above", 3)?,
            rows: [
                gpu.upload("operator rows", &forward.start)?,
                gpu.upload("transposed rows", &backward.start)?,
            ],
            entries: [
                gpu.upload("operator entries", &forward.entries)?,
                gpu.upload("transposed entries", &backward.entries)?,
            ],
            harmonics: gpu.upload("harmonics of the texels", operators.harmonics())?,
            upward: gpu.upload("upward shares", &upward)?,
            reading: gpu.upload("reading of the roughest level", &basis_reading(&tables))?,
            size: (width, height),
            light,
        })
    }

    fn environment(
        &self,
        model: &ModelBuffers,
        turned: TurnedLight,
        weights: &LightWeights,
    ) -> EnvironmentUniform {
        let (width, height) = self.size;
        let (whole, fraction) = ColumnShift::new(turned.radians, width).columns();
        EnvironmentUniform {
            n_texels: (width * height) as u32,
            first_texel: 3 * (model.n_prototypes + turned.group * width * height) as u32,
            neutrality: weights.neutrality / (3 * width * height).max(1) as f32,
            exposure: weights.exposure,
            colour: weights.colour,
            blue_over_red: weights.wanted.blue_over_red,
            green: weights.wanted.green,
            tolerance: weights.tolerance,
            width: width as u32,
            whole: whole as u32,
            fraction,
        }
    }

    /// Computes the tables of `turned`, one of the model's current lights, and the terms on it. Clears the gradients.
    pub fn apply(
        &self,
        recorder: &mut Recorder<'_>,
        model: &ModelBuffers,
        turned: TurnedLight,
        weights: &LightWeights,
        losses: &Buffer<f32>,
    ) {
        recorder.stage("light");
        recorder.clear(&self.tables_gradient);
        recorder.clear(&self.basis_gradient);
        let environment = uniform(&self.environment(model, turned, weights));
        let (globals, upward) = ((&model.globals).into(), (&self.upward).into());
        let bindings = [
            environment,
            globals,
            upward,
            (&self.radiance).into(),
            (&self.by_sky_light).into(),
            losses.into(),
            (&self.turned).into(),
        ];
        recorder.dispatch(&shaders::ENV_RADIANCE, Groups::Workgroups(1), &bindings);
        let values = &self.light.values;
        let bindings = [
            uniform(&self.light.layout),
            (&self.turned).into(),
            (&self.rows[0]).into(),
            (&self.entries[0]).into(),
            (&self.harmonics).into(),
            values.into(),
        ];
        recorder.dispatch(&shaders::ENV_TABLES, Groups::Linear(values.len()), &bindings);
        let bindings = [
            uniform(&self.light.layout),
            values.into(),
            (&self.reading).into(),
            (&self.light.indirect_basis).into(),
        ];
        recorder.dispatch(&shaders::ENV_BASIS, Groups::Workgroups(1), &bindings);
    }

    /// Writes the gradient of the raw environment, for the light of the last [`Self::apply`], into its part of
    /// `globals_gradient`. The basis has a gradient where `indirect` is `Learned`.
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        model: &ModelBuffers,
        turned: TurnedLight,
        weights: &LightWeights,
        indirect: IndirectForm,
        globals_gradient: &Buffer<f32>,
    ) {
        recorder.stage("light backward");
        if indirect == IndirectForm::Learned {
            let bindings = [
                uniform(&self.light.layout),
                (&self.basis_gradient).into(),
                (&self.reading).into(),
                (&self.tables_gradient).into(),
            ];
            let floats = 3 * self.reading.len() / 16;
            recorder.dispatch(&shaders::ENV_BASIS_BACKWARD, Groups::Linear(floats), &bindings);
        }
        let bindings = [
            uniform(&self.light.layout),
            uniform(&self.environment(model, turned, weights)),
            (&model.globals).into(),
            (&self.radiance).into(),
            (&self.upward).into(),
            (&self.by_sky_light).into(),
            (&self.tables_gradient).into(),
            (&self.rows[1]).into(),
            (&self.entries[1]).into(),
            (&self.harmonics).into(),
            globals_gradient.into(),
        ];
        recorder.dispatch(&shaders::ENV_BACKWARD, Groups::Workgroups(self.size.0 * self.size.1), &bindings);
    }
}

/// `B_j(node)`: the weights of the roughest level's nodes in `E_j = 1/32 sum_k Y_j(w_k) L_low(w_k)` (Eq. 20).
fn basis_reading(tables: &LightTables) -> Vec<f32> {
    let grid = tables.specular_grids[tables.specular_grids.len() - 1];
    let mut out = vec![0.0f32; 16 * grid.len()];
    for d in fibonacci_sphere(INDIRECT_DIRECTIONS) {
        let mut y = [0.0f32; 16];
        sh_eval(3, d, &mut y);
        let taps = grid.lookup(d);
        for k in 0..4 {
            for (j, y) in y.iter().enumerate() {
                out[j * grid.len() + taps.node[k]] += y * taps.weight[k] / INDIRECT_DIRECTIONS as f32;
            }
        }
    }
    out
}
