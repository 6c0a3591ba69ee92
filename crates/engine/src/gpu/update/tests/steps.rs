//! Adam against f64.

use super::*;
use relume_compare::largest_difference;

/// Adam of one parameter in f64.
#[derive(Clone, Copy, Default)]
struct Plain {
    first: f64,
    second: f64,
}

impl Plain {
    fn step(&mut self, gradient: f64, rate: f64, age: u32) -> f64 {
        self.first = 0.9 * self.first + 0.1 * gradient;
        self.second = 0.999 * self.second + 0.001 * gradient * gradient;
        let (a, b) = (1.0 - 0.9f64.powi(age as i32), 1.0 - 0.999f64.powi(age as i32));
        rate * (self.first / a) / ((self.second / b).sqrt() + 1e-15)
    }
}

fn rates() -> StepSizes {
    StepSizes { fields: std::array::from_fn(|i| 1e-3 * (i + 1) as f32), prototypes: 2e-3, environment: 0.0 }
}

/// Step size of planar element `at`, and whether it has the material's step count.
fn rate_at(g: &Gaussians, rates: &StepSizes, at: usize) -> (f64, bool) {
    let field = Field::ALL.into_iter().find(|f| range(g, *f).contains(&at)).unwrap();
    let rate = f64::from(rates.fields[field as usize]);
    let k = (at - range(g, field).start) % g.width(field);
    let rest = field == Field::Radiance && k >= 3;
    let geometry = [Field::Mean, Field::LogScale, Field::Quaternion, Field::OpacityLogit, Field::Radiance];
    (if rest { rate * 0.05 } else { rate }, !geometry.contains(&field))
}

fn step(device: &OnDevice, terms: &ParameterWeights, rates: &StepSizes, ages: StepCounts) {
    let mut recorder = device.gpu.record();
    device.updater.step(&mut recorder, &device.input(terms), rates, ages);
    recorder.submit().unwrap();
}

fn step_globals(device: &OnDevice, rates: &StepSizes, ages: StepCounts) {
    let mut recorder = device.gpu.record();
    device.updater.step_globals(&mut recorder, &device.model, &device.sums(), rates, ages);
    recorder.submit().unwrap();
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn parameter_steps_match_adam_at_every_step_count_and_rate() {
    let gpu = Gpu::for_tests();
    let options = ShadingOptions { indirect: IndirectForm::Learned, ..Default::default() };
    let case = UpdateCase::new(&Shape { options, ..Default::default() }, 21, |_| ());
    let device = OnDevice::new(&gpu, &case);
    let g = &case.model.gaussians;
    let mut rates = rates();
    rates.fields[Field::RoughLogit as usize] = 0.0;
    let terms = ParameterWeights { aggregation: 0.1, residual: 0.1, flatness: 1.0, ..Default::default() };
    let mut plain = vec![Plain::default(); device.model.layout.floats()];
    for round in 0..4u32 {
        let ages = StepCounts { geometry: 500 + round, material: 1 + round };
        let before = device.params();
        let (gradient, _) = device.gradients(&terms);
        step(&device, &terms, &rates, ages);
        let after = device.params();
        let mut moved = 0;
        for at in 0..before.len() {
            let (rate, material) = rate_at(g, &rates, at);
            if rate == 0.0 {
                assert_eq!(before[at], after[at]);
                continue;
            }
            let age = if material { ages.material } else { ages.geometry };
            let expected = f64::from(before[at]) - plain[at].step(f64::from(gradient[at]), rate, age);
            let error = (f64::from(after[at]) - expected).abs();
            let least = 2e-7 * f64::from(before[at].abs());
            assert!(error < least + 2e-4 * rate, "step {round} element {at}: {error:e} of {rate:e}");
            moved += usize::from((f64::from(after[at]) - f64::from(before[at])).abs() > 0.1 * rate);
        }
        assert!(moved > before.len() / 4, "the control: most elements move, not {moved}");
    }
    let second = device.model.read_gaussians(&gpu, &device.model.second, g).unwrap();
    assert!(second.field(Field::RoughLogit).iter().all(|v| *v == 0.0), "rate 0 leaves moments alone");
    assert!(second.field(Field::MetalLogit).iter().any(|v| *v > 0.0));
    assert_eq!(device.poisoned(), 0);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn shared_parameters_use_the_material_step_count() {
    let gpu = Gpu::for_tests();
    let case = UpdateCase::new(&Shape::default(), 22, |_| ());
    let device = OnDevice::new(&gpu, &case);
    let n = device.model.globals.len();
    let gradient: Vec<f32> = (0..n).map(|i| (i as f32 * 1.3).sin()).collect();
    gpu.write(&device.globals_gradient, 0, &gradient);
    let read = || gpu.read(&device.model.globals, 0..n).unwrap();
    let mut expected: Vec<f64> = read().into_iter().map(f64::from).collect();
    let mut plain = vec![Plain::default(); n];
    let rates = StepSizes { environment: 1e-2, ..rates() };
    for round in 0..3 {
        let ages = StepCounts { geometry: 90, material: 4 + round };
        step_globals(&device, &rates, ages);
        for (at, e) in expected.iter_mut().enumerate() {
            let rate = if at < 24 { 2e-3f32 } else { 1e-2f32 };
            *e -= plain[at].step(f64::from(gradient[at]), f64::from(rate), ages.material);
        }
    }
    let error = |expected: &[f64]| largest_difference(&read(), expected);
    assert!(error(&expected) < 2e-6, "{:e}", error(&expected));
    expected[24] += 1e-4;
    assert!(error(&expected) > 2e-6, "the control");
    let before = read();
    let still = StepSizes { environment: 0.0, prototypes: 0.0, ..rates };
    step_globals(&device, &still, StepCounts { geometry: 1, material: 1 });
    assert_eq!(read(), before);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn non_finite_gradient_is_reported_and_changes_no_parameter() {
    let gpu = Gpu::for_tests();
    let case = UpdateCase::new(&Shape::default(), 23, |_| ());
    let seen = case.expected.visible.iter().position(|v| *v).unwrap();
    let ages = StepCounts { geometry: 1, material: 1 };
    for (poison, value) in [(true, f32::NAN), (true, f32::INFINITY), (false, 0.5)] {
        let device = OnDevice::new(&gpu, &case);
        // The gradient by opacity: without compensation only the logit depends on it.
        gpu.write(&device.rows, seen * (8 + 4 * case.groups) + 5, &[value]);
        let before = device.params();
        step(&device, &ParameterWeights::default(), &rates(), ages);
        let after = device.params();
        let at = range(&case.model.gaussians, Field::OpacityLogit).start + seen;
        assert_eq!((device.poisoned() != 0, before[at] == after[at]), (poison, poison));
        assert!(after.iter().all(|v| v.is_finite()));

        gpu.write(&device.status, 0, &[0u32]);
        let mut broken = vec![0.0f32; device.model.globals.len()];
        broken[2] = value;
        gpu.write(&device.globals_gradient, 0, &broken);
        let before = gpu.read(&device.model.globals, 0..3).unwrap();
        step_globals(&device, &rates(), ages);
        let after = gpu.read(&device.model.globals, 0..3).unwrap();
        assert_eq!((device.poisoned() != 0, before[2] == after[2]), (poison, poison));
    }
}
