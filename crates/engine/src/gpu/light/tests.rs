//! A training's light against the host's operators.

use crate::gpu::light::training::EnvironmentUniform;
use crate::gpu::light::{TablesUniform, TrainingLight};
use crate::gpu::model::ModelBuffers;
use crate::gpu::shaders::assert_layout;
use crate::gpu::{Buffer, Gpu, shaders};
use crate::{LightWeights, TurnedLight, indirect_basis, indirect_basis_backward};
use relume_compare::{relative_error, worst};
use relume_scene::light::{EnvOperators, LUMINANCE, LightColour, TableResolution, UPWARD_LUMINANCE};
use relume_scene::{
    ColumnShift, Gaussians, IndirectForm, LightSplit, MAX_LIGHTS, Model, SplitLight, softplus,
    texel_directions,
};

const WEIGHTS: LightWeights = LightWeights {
    neutrality: 0.3,
    exposure: 0.7,
    colour: 0.4,
    wanted: LightColour { blue_over_red: 0.45, green: -0.2 },
    tolerance: 0.05,
};

const TOLERANCE: f64 = WEIGHTS.tolerance as f64;

/// Light groups of the model.
const GROUPS: usize = 2;
/// Texels of an environment.
const TEXELS: usize = 128;

/// Rotations: none, whole columns, and a fraction of a column. The last two lights are of another group.
const LIGHTS: [TurnedLight; 4] = [
    TurnedLight { group: 0, radians: 0.0 },
    TurnedLight { group: 0, radians: std::f64::consts::FRAC_PI_2 },
    TurnedLight { group: 1, radians: 0.0 },
    TurnedLight { group: 1, radians: 2.1 },
];

fn model() -> Model {
    let env_raw: Vec<[f32; 3]> = (0..GROUPS * TEXELS)
        .map(|i| std::array::from_fn(|c| ((i * 7 + c * 3) % 11) as f32 * 0.3 - 1.2))
        .collect();
    Model::new(Gaussians::zeroed(3, 2, 2, 0), vec![[0.5; 3]; 2], env_raw, (16, 8))
}

struct Run {
    operators: EnvOperators,
    light: TrainingLight,
    buffers: ModelBuffers,
    losses: Buffer<f32>,
}

fn applied(gpu: &Gpu, model: &Model, turned: TurnedLight) -> Run {
    let mut shares = vec![[0.0; MAX_LIGHTS]; TEXELS];
    (30..33).for_each(|t| shares[t] = [0.5, 0.25, 0.0, 0.0]);
    shares[5] = [0.0, 0.0, 0.9, 0.0];
    let light = SplitLight { direction: [0.0, 0.6, 0.8], radius: 0.1 };
    let split = LightSplit { lights: vec![light; 3], shares };
    let operators = EnvOperators::new(16, 8, 2, TableResolution::TRAINING).with_lights(&split);
    let light = TrainingLight::new(gpu, &operators).unwrap();
    let buffers = ModelBuffers::upload(gpu, model).unwrap();
    let losses = gpu.buffer("losses", 16).unwrap();
    let mut recorder = gpu.record();
    recorder.clear(&losses);
    light.apply(&mut recorder, &buffers, turned, &WEIGHTS, &losses);
    recorder.submit().unwrap();
    Run { operators, light, buffers, losses }
}

fn radiance(model: &Model, group: usize) -> Vec<[f32; 3]> {
    model.env_raw_of(group).iter().map(|t| t.map(softplus)).collect()
}

/// The terms on the light in f64: value, and gradient by radiance.
fn terms(radiance: &[[f32; 3]]) -> (f64, f64) {
    let upward: Vec<f64> =
        texel_directions(16, 8).iter().map(|(d, w)| d.z.max(0.0) * w / std::f64::consts::PI).collect();
    let (mut neutral, mut above) = (0.0, [0.0; 3]);
    for (l, share) in radiance.iter().zip(upward) {
        let l = l.map(f64::from);
        let grey = (l[0] + l[1] + l[2]) / 3.0;
        neutral += l.iter().map(|v| (v - grey).abs()).sum::<f64>();
        (0..3).for_each(|c| above[c] += share * l[c]);
    }
    let n = 3.0 * radiance.len() as f64;
    let up: f64 = above.iter().zip(LUMINANCE).map(|(a, share)| a * f64::from(share)).sum();
    let level = (up / f64::from(UPWARD_LUMINANCE)).ln();
    let blue = (above[2] / above[0]).ln() - f64::from(WEIGHTS.wanted.blue_over_red);
    let green = (above[1] * above[1] / (above[0] * above[2])).ln() - f64::from(WEIGHTS.wanted.green);
    let beyond = |distance: f64| distance - distance.clamp(-TOLERANCE, TOLERANCE);
    let colour = beyond(blue).powi(2) + beyond(green).powi(2);
    let by_above = f64::from(WEIGHTS.exposure) * level.powi(2) + f64::from(WEIGHTS.colour) * colour;
    (f64::from(WEIGHTS.neutrality) * neutral / n, by_above)
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn light_tables_and_basis_match_the_host() {
    let gpu = Gpu::for_tests();
    let model = model();
    for turned in LIGHTS {
        assert_tables_and_basis_match_the_host(&gpu, &model, turned);
    }
    assert_layout!(TablesUniform as "Tables" in shaders::ENV_TABLES; diffuse_n, coefficients, n_coefficients,
        n_specular, specular_n, specular_first, n_lights, first_light, pad_a, pad_b, lights);
    assert_layout!(EnvironmentUniform as "Environment" in shaders::ENV_BACKWARD; n_texels, first_texel, neutrality,
        exposure, colour, blue_over_red, green, tolerance, width, whole, fraction);
}

fn assert_tables_and_basis_match_the_host(gpu: &Gpu, model: &Model, turned: TurnedLight) {
    let run = applied(gpu, model, turned);
    let (turn, shown) = (turned.radians, radiance(model, turned.group));
    let host = |radiance: &[[f32; 3]], turn: f64| {
        run.operators.apply(&ColumnShift::new(turn, model.env_width).apply(radiance))
    };
    let expected = host(&shown, turn);
    let light = &run.light.light;
    let values = gpu.read(&light.values, 0..light.values.len()).unwrap();
    assert!(relative_error(&values, &expected.flat()) < 2e-6);
    let basis = gpu.read(&light.indirect_basis, 0..48).unwrap();
    assert!(relative_error(&basis, indirect_basis(&expected).as_flattened()) < 3e-6);
    let mut other = shown.clone();
    other[5][1] += 0.05;
    let control = relative_error(&values, &host(&other, turn).flat());
    assert!(control > 1e-4, "the control: one texel shows");
    let control = relative_error(&values, &host(&shown, turn + 0.1).flat());
    assert!(control > 1e-2, "the control: a turn shows");
    let control = relative_error(&values, &host(&radiance(model, 1 - turned.group), turn).flat());
    assert!(control > 1e-2, "the control: the other group shows");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn light_gradient_is_the_transposed_operator_plus_the_terms() {
    let gpu = Gpu::for_tests();
    for turned in LIGHTS {
        assert_light_gradient_is_transposed_operator_plus_terms(&gpu, turned);
    }
}

fn assert_light_gradient_is_transposed_operator_plus_terms(gpu: &Gpu, light: TurnedLight) {
    let model = model();
    let run = applied(gpu, &model, light);
    let shown = radiance(&model, light.group);
    let losses = gpu.read(&run.losses, 0..16).unwrap();
    let (neutral, exposure) = terms(&shown);
    assert!((f64::from(losses[9]) - neutral).abs() < 1e-5 * neutral, "{} {neutral}", losses[9]);
    assert!((f64::from(losses[10]) - exposure).abs() < 1e-5 * exposure, "{} {exposure}", losses[10]);
    // An arbitrary gradient of the tables and of the basis.
    let mut by_tables = run.operators.shape();
    by_tables.diffuse.iter_mut().enumerate().for_each(|(i, v)| *v = ((i * 31) % 17) as f32 * 1e-3 - 8e-3);
    for level in &mut by_tables.specular {
        level
            .iter_mut()
            .enumerate()
            .for_each(|(i, v)| *v = [(i % 3) as f32 * 1e-3, -1e-3, (i % 5) as f32 * 1e-3]);
    }
    by_tables.lights.iter_mut().for_each(|l| l.irradiance = [0.4, -0.3, 0.2]);
    let by_basis: [[f32; 3]; 16] = std::array::from_fn(|j| [0.1 * j as f32, -0.2, 0.05]);
    gpu.write(&run.light.tables_gradient, 0, &by_tables.flat());
    gpu.write(&run.light.basis_gradient, 0, by_basis.as_flattened());
    let out: Buffer<f32> = gpu.buffer("gradient", run.buffers.globals.len()).unwrap();
    let mut recorder = gpu.record();
    recorder.clear(&out);
    run.light.backward(&mut recorder, &run.buffers, light, &WEIGHTS, IndirectForm::Learned, &out);
    recorder.submit().unwrap();
    let written = gpu.read(&out, 6..out.len()).unwrap();
    let (first, second) = written.split_at(3 * TEXELS);
    let (found, other) = if light.group == 0 { (first, second) } else { (second, first) };
    assert!(other.iter().all(|v| *v == 0.0), "the other group has no gradient");
    indirect_basis_backward(&by_basis, &mut by_tables);
    let turned = ColumnShift::new(light.radians, model.env_width);
    let mut expected = turned.apply_transposed(&run.operators.apply_transposed(&by_tables)).into_owned();
    // The terms by central differences of their f64 values.
    for t in 0..expected.len() {
        for c in 0..3 {
            let at = |step: f32| {
                let mut moved = shown.clone();
                moved[t][c] += step;
                let (a, b) = terms(&moved);
                a + b
            };
            expected[t][c] += ((at(1e-3) - at(-1e-3)) / 2e-3) as f32;
            expected[t][c] /= 1.0 + (-model.env_raw_of(light.group)[t][c]).exp();
        }
    }
    let error = relative_error(found, expected.as_flattened());
    assert!(error < 2e-3, "{error}");
    expected[0][0] += 0.01 * worst(expected.as_flattened().iter().map(|v| v.abs())) as f32;
    let control = relative_error(found, expected.as_flattened());
    assert!(
        control.is_finite() && control > 5e-3,
        "the control, one texel of the expected gradient changed: {control}"
    );
}
