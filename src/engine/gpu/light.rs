//! Environments on the device: tables of a finished light, and the operators of one that trains.

use bytemuck::{Pod, Zeroable};

use crate::engine::fibonacci_sphere;
use crate::engine::gpu::model::ModelBuffers;
use crate::engine::gpu::{Buffer, Gpu, GpuError, Groups, Recorder, shaders, uniform};
use crate::engine::indirect::INDIRECT_DIRECTIONS;
use crate::light::{BrdfLut, CubeGrid, DAYLIGHT, EnvOperators, LightTables, LobeAttenuation, sh_eval};
use crate::scene::{sh_count, texel_directions};

/// The tables of the reflectance model, uploaded once a device: 32 x 32 pairs `[roughness][n.v][scale, bias]`, then
/// 33 x 9 attenuations `[roughness][degree]`.
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

/// `Tables` of `shaders/shared/tables.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct TablesUniform {
    /// Nodes along an edge of the grid of normals.
    pub diffuse_n: u32,
    /// Padded coefficients a colour.
    pub coefficients: u32,
    /// Coefficients in use.
    pub n_coefficients: u32,
    /// Nodes of all levels together.
    pub n_specular: u32,
    /// Nodes along an edge, per level; the last two are unused.
    pub specular_n: [u32; 8],
    /// First float, per level; the last two are unused.
    pub specular_first: [u32; 8],
}

impl TablesUniform {
    /// Where `tables`, for a visibility field of degree `order`, lie in one buffer.
    pub fn new(tables: &LightTables, order: usize) -> Self {
        let edge = |grid: &CubeGrid| grid.edge() as u32;
        let mut out = Self {
            diffuse_n: edge(&tables.diffuse_grid),
            coefficients: tables.coefficients as u32,
            n_coefficients: sh_count(order) as u32,
            ..Self::zeroed()
        };
        let mut next = tables.diffuse.len() as u32;
        for (k, (grid, level)) in tables.specular_grids.iter().zip(&tables.specular).enumerate() {
            out.specular_n[k] = edge(grid);
            out.specular_first[k] = next;
            out.n_specular += level.len() as u32;
            next += 3 * level.len() as u32;
        }
        out
    }

    /// Floats of the whole buffer.
    pub fn floats(&self) -> usize {
        self.specular_first[0] as usize + 3 * self.n_specular as usize
    }
}

/// The tables of one light in device memory.
#[derive(Debug, Clone)]
pub struct LightBuffers {
    /// Where they lie.
    pub layout: TablesUniform,
    /// The tables.
    pub values: Buffer<f32>,
    /// `E_j` of Eq. 20, `[16][3]`.
    pub indirect_basis: Buffer<f32>,
}

/// All floats of `tables` in the order of the device's buffer.
pub fn flat(tables: &LightTables) -> Vec<f32> {
    let levels = tables.specular.iter().flatten().flatten();
    tables.diffuse.iter().chain(levels).copied().collect()
}

impl LightBuffers {
    /// Uploads finished tables.
    ///
    /// # Errors
    /// When they do not fit.
    pub fn upload(
        gpu: &Gpu,
        tables: &LightTables,
        order: usize,
        indirect_basis: &[[f32; 3]; 16],
    ) -> Result<Self, GpuError> {
        Ok(Self {
            layout: TablesUniform::new(tables, order),
            values: gpu.upload("light tables", &flat(tables))?,
            indirect_basis: gpu.upload("indirect basis", indirect_basis.as_flattened())?,
        })
    }
}

/// `Environment` of `shaders/shared/environment.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
struct EnvironmentUniform {
    n_texels: u32,
    first_texel: u32,
    neutrality: f32,
    exposure: f32,
    daylight: f32,
    blue_over_red: f32,
}

/// Weights of the terms on the light (docs/MODEL.md section 5).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LightWeights {
    /// Light neutrality, Eq. 31.
    pub neutrality: f32,
    /// Exposure.
    pub exposure: f32,
    /// Daylight.
    pub daylight: f32,
}

/// The environment operators of a training, with the light they were last applied to and the gradient of its tables.
#[derive(Debug, Clone)]
pub struct TrainingLight {
    /// The tables of the light as it was when [`TrainingLight::apply`] ran.
    pub light: LightBuffers,
    /// Gradient of the tables; cleared by [`TrainingLight::apply`], added to by the shading.
    pub tables_gradient: Buffer<f32>,
    /// Gradient of the indirect basis; likewise.
    pub basis_gradient: Buffer<f32>,
    radiance: Buffer<f32>,
    light_slope: Buffer<f32>,
    rows: [Buffer<u32>; 2],
    entries: [Buffer<[u32; 2]>; 2],
    harmonics: Buffer<f32>,
    upward: Buffer<f32>,
    reading: Buffer<f32>,
    n_texels: usize,
}

impl TrainingLight {
    /// Uploads the operators.
    ///
    /// # Errors
    /// When they do not fit.
    pub fn new(gpu: &Gpu, operators: &EnvOperators) -> Result<Self, GpuError> {
        let tables = operators.shape();
        let light = LightBuffers::upload(gpu, &tables, operators.order(), &[[0.0; 3]; 16])?;
        let (forward, backward) = (operators.rows(), operators.transposed_rows());
        let (width, height) = operators.size();
        let upward: Vec<f32> = texel_directions(width, height)
            .iter()
            .map(|(d, w)| (d.z.max(0.0) * w / (3.0 * std::f64::consts::PI)) as f32)
            .collect();
        Ok(Self {
            tables_gradient: gpu.buffer("gradient of the light tables", light.values.len())?,
            basis_gradient: gpu.buffer("gradient of the indirect basis", 48)?,
            radiance: gpu.buffer("radiance", 3 * width * height)?,
            light_slope: gpu.buffer("slope by the light from above", 3)?,
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
            n_texels: width * height,
            light,
        })
    }

    fn environment(&self, model: &ModelBuffers, weights: &LightWeights) -> EnvironmentUniform {
        EnvironmentUniform {
            n_texels: self.n_texels as u32,
            first_texel: 3 * model.n_prototypes as u32,
            neutrality: weights.neutrality / (3 * self.n_texels).max(1) as f32,
            exposure: weights.exposure,
            daylight: weights.daylight,
            blue_over_red: (DAYLIGHT[2] / DAYLIGHT[0]).ln(),
        }
    }

    /// Tables of the model's environment as it is now, and the values of the terms on it; clears the gradients.
    pub fn apply(
        &self,
        recorder: &mut Recorder<'_>,
        model: &ModelBuffers,
        weights: &LightWeights,
        losses: &Buffer<f32>,
    ) {
        recorder.stage("light");
        recorder.clear(&self.tables_gradient);
        recorder.clear(&self.basis_gradient);
        let environment = uniform(&self.environment(model, weights));
        let (globals, upward) = ((&model.globals).into(), (&self.upward).into());
        let bindings = [
            environment,
            globals,
            upward,
            (&self.radiance).into(),
            (&self.light_slope).into(),
            losses.into(),
        ];
        recorder.dispatch(&shaders::ENV_RADIANCE, Groups::Workgroups(1), &bindings);
        let values = &self.light.values;
        let bindings = [
            uniform(&self.light.layout),
            (&self.radiance).into(),
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

    /// Gradient of the raw environment, written over its part of `globals_gradient`; `learned_indirect` says whether
    /// the basis has a gradient.
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        model: &ModelBuffers,
        weights: &LightWeights,
        learned_indirect: bool,
        globals_gradient: &Buffer<f32>,
    ) {
        recorder.stage("light backward");
        if learned_indirect {
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
            uniform(&self.environment(model, weights)),
            (&model.globals).into(),
            (&self.radiance).into(),
            (&self.upward).into(),
            (&self.light_slope).into(),
            (&self.tables_gradient).into(),
            (&self.rows[1]).into(),
            (&self.entries[1]).into(),
            (&self.harmonics).into(),
            globals_gradient.into(),
        ];
        recorder.dispatch(&shaders::ENV_BACKWARD, Groups::Workgroups(self.n_texels), &bindings);
    }
}

/// `B_j(node)`: how `E_j = 1/32 sum_k Y_j(w_k) L_low(w_k)` (Eq. 20) reads the nodes of the roughest level.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::gpu::shaders::assert_layout;
    use crate::engine::{indirect_basis, indirect_basis_backward};
    use crate::light::TableResolution;
    use crate::scene::{Gaussians, Model, ShadingOptions, softplus};

    const WEIGHTS: LightWeights = LightWeights { neutrality: 0.3, exposure: 0.7, daylight: 0.4 };

    fn model() -> Model {
        let env_raw: Vec<[f32; 3]> =
            (0..128).map(|i| std::array::from_fn(|c| ((i * 7 + c * 3) % 11) as f32 * 0.3 - 1.2)).collect();
        Model {
            gaussians: Gaussians::zeroed(3, 2, 2, 0),
            prototypes: vec![[0.5; 3]; 2],
            env_raw,
            env_width: 16,
            env_height: 8,
            shading: ShadingOptions::default(),
            world_scale: 1.0,
            world_offset: glam::DVec3::ZERO,
            card: serde_json::Value::Null,
        }
    }

    struct Run {
        operators: EnvOperators,
        light: TrainingLight,
        buffers: ModelBuffers,
        losses: Buffer<f32>,
    }

    fn applied(gpu: &Gpu, model: &Model) -> Run {
        let operators = EnvOperators::new(16, 8, 2, TableResolution::TRAINING);
        let light = TrainingLight::new(gpu, &operators).unwrap();
        let buffers = ModelBuffers::upload(gpu, model).unwrap();
        let losses = gpu.buffer("losses", 16).unwrap();
        let mut recorder = gpu.record();
        recorder.clear(&losses);
        light.apply(&mut recorder, &buffers, &WEIGHTS, &losses);
        recorder.submit().unwrap();
        Run { operators, light, buffers, losses }
    }

    fn radiance(model: &Model) -> Vec<[f32; 3]> {
        model.env_raw.iter().map(|t| t.map(softplus)).collect()
    }

    fn worst(a: &[f32], b: &[f32]) -> f32 {
        assert_eq!(a.len(), b.len());
        let most = b.iter().fold(1e-12f32, |m, v| m.max(v.abs()));
        a.iter().zip(b).fold(0.0f32, |m, (a, b)| m.max((a - b).abs() / most))
    }

    /// The terms on the light in f64: value, and gradient by radiance.
    fn terms(radiance: &[[f32; 3]]) -> (f64, f64) {
        let upward: Vec<f64> = texel_directions(16, 8)
            .iter()
            .map(|(d, w)| d.z.max(0.0) * w / (3.0 * std::f64::consts::PI))
            .collect();
        let (mut neutral, mut above) = (0.0, [0.0; 3]);
        for (l, share) in radiance.iter().zip(upward) {
            let l = l.map(f64::from);
            let grey = (l[0] + l[1] + l[2]) / 3.0;
            neutral += l.iter().map(|v| (v - grey).abs()).sum::<f64>();
            (0..3).for_each(|c| above[c] += share * l[c]);
        }
        let n = 3.0 * radiance.len() as f64;
        let level = above.iter().sum::<f64>().ln();
        let colour = (above[2] / above[0]).ln() - f64::from(DAYLIGHT[2] / DAYLIGHT[0]).ln();
        let by_above =
            f64::from(WEIGHTS.exposure) * level.powi(2) + f64::from(WEIGHTS.daylight) * colour.powi(2);
        (f64::from(WEIGHTS.neutrality) * neutral / n, by_above)
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn tables_and_basis_are_those_of_the_host() {
        let gpu = Gpu::for_tests();
        let model = model();
        let run = applied(&gpu, &model);
        let expected = run.operators.apply(&radiance(&model));
        assert_layout!(TablesUniform as "Tables" in shaders::ENV_TABLES; diffuse_n, coefficients, n_coefficients,
            n_specular, specular_n, specular_first);
        assert_layout!(EnvironmentUniform as "Environment" in shaders::ENV_BACKWARD; n_texels, first_texel, neutrality,
            exposure, daylight, blue_over_red);
        let light = &run.light.light;
        let values = gpu.read(&light.values, 0..light.values.len()).unwrap();
        assert!(worst(&values, &flat(&expected)) < 2e-6);
        let basis = gpu.read(&light.indirect_basis, 0..48).unwrap();
        assert!(worst(&basis, indirect_basis(&expected).as_flattened()) < 3e-6);
        let mut other = radiance(&model);
        other[5][1] += 0.05;
        assert!(worst(&values, &flat(&run.operators.apply(&other))) > 1e-4, "the control: one texel shows");
    }

    #[test]
    #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
    fn the_gradient_of_the_light_is_the_transposed_operator_and_the_terms() {
        let gpu = Gpu::for_tests();
        let mut model = model();
        let run = applied(&gpu, &model);
        let losses = gpu.read(&run.losses, 0..16).unwrap();
        let (neutral, exposure) = terms(&radiance(&model));
        assert!((f64::from(losses[9]) - neutral).abs() < 1e-5 * neutral, "{} {neutral}", losses[9]);
        assert!((f64::from(losses[10]) - exposure).abs() < 1e-5 * exposure, "{} {exposure}", losses[10]);
        // A made-up gradient of the tables and of the basis.
        let mut by_tables = run.operators.shape();
        by_tables.diffuse.iter_mut().enumerate().for_each(|(i, v)| *v = ((i * 31) % 17) as f32 * 1e-3 - 8e-3);
        for level in &mut by_tables.specular {
            level
                .iter_mut()
                .enumerate()
                .for_each(|(i, v)| *v = [(i % 3) as f32 * 1e-3, -1e-3, (i % 5) as f32 * 1e-3]);
        }
        let by_basis: [[f32; 3]; 16] = std::array::from_fn(|j| [0.1 * j as f32, -0.2, 0.05]);
        gpu.write(&run.light.tables_gradient, 0, &flat(&by_tables));
        gpu.write(&run.light.basis_gradient, 0, by_basis.as_flattened());
        let out: Buffer<f32> = gpu.buffer("gradient", run.buffers.globals.len()).unwrap();
        let mut recorder = gpu.record();
        run.light.backward(&mut recorder, &run.buffers, &WEIGHTS, true, &out);
        recorder.submit().unwrap();
        let found = gpu.read(&out, 6..out.len()).unwrap();
        indirect_basis_backward(&by_basis, &mut by_tables);
        let mut expected = run.operators.apply_transposed(&by_tables);
        // The terms by central differences of their f64 values.
        for t in 0..expected.len() {
            for c in 0..3 {
                let at = |step: f32| {
                    let mut moved = radiance(&model);
                    moved[t][c] += step;
                    let (a, b) = terms(&moved);
                    a + b
                };
                expected[t][c] += ((at(1e-3) - at(-1e-3)) / 2e-3) as f32;
                expected[t][c] /= 1.0 + (-model.env_raw[t][c]).exp();
            }
        }
        let error = worst(&found, expected.as_flattened());
        assert!(error < 2e-3, "{error}");
        model.env_raw[0][0] += 1.0;
        assert!(worst(&found, &found.iter().map(|v| v * 1.01).collect::<Vec<_>>()) > 5e-3, "the control");
    }
}
