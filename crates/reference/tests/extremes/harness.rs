//! One case on three engines: the CPU and the GPU engine are compared with the f64 reference.

use std::sync::LazyLock;

use glam::DVec3;
use relume_compare::relative_error;
use relume_engine::Device;
pub(super) use relume_fixtures::model::{ENV, SH_DEGREE, model};
use relume_reference::parity::{
    LightShape, ParityCase, ParityResult, cpu_result, gpu_result, reference_result, stable_pixels,
};
use relume_scene::light::TableResolution;
use relume_scene::{Camera, Field, Model};

pub(super) const BACKGROUND: [f32; 3] = [0.25, 0.5, 0.75];
pub(super) const TABLES: TableResolution = TableResolution { diffuse: 5, sharp: 7, rough: 5 };
/// Smallest relative distance of all splats of a counted pixel from a threshold of alpha.
const MARGIN: f64 = 2e-3;
/// Errors of a parameter's gradient are relative to its largest entry, but at least to this share of the largest entry of all
/// parameters: where the true gradient is 0, the rounding of cancelled terms is no error.
const MIN_GRADIENT_SHARE: f64 = 1e-5;

pub(super) static LIGHT: LazyLock<LightShape> =
    LazyLock::new(|| LightShape::new(ENV.0, ENV.1, SH_DEGREE, TABLES));

/// Sets every row of `field` in turn.
pub(super) fn set<const W: usize>(model: &mut Model, field: Field, rows: &[[f32; W]]) {
    for (i, row) in rows.iter().enumerate() {
        model.gaussians.row_mut(field, i).copy_from_slice(row);
    }
}

/// Looks at the origin from `eye`, with a vertical field of view of 34 degrees.
pub(super) fn looking_from(eye: [f64; 3], size: (u32, u32)) -> Camera {
    Camera::look_at(eye.into(), DVec3::ZERO, DVec3::Z, 0.6, size).unwrap()
}

/// A camera at (0, -3, 0): depth is exactly y + 3.
pub(super) fn in_front(size: (u32, u32)) -> Camera {
    looking_from([0.0, -3.0, 0.0], size)
}

/// Generates two tests of each function with a `&Device`: one on the CPU engine, one on the GPU engine.
macro_rules! on_each_engine {
    ($($case:ident),* $(,)?) => {
        mod cpu_engine {
            $(#[test]
            fn $case() {
                super::$case(&relume_engine::Device::Cpu);
            })*
        }
        mod gpu_engine {
            $(#[test]
            #[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
            fn $case() {
                super::$case(relume_reference::gpu_device());
            })*
        }
    };
}
pub(super) use on_each_engine;

/// Largest errors allowed, relative to the largest value of an image and to the largest gradient of a parameter.
#[derive(Clone, Copy)]
pub(super) struct Bounds {
    pub(super) image: f64,
    pub(super) gradient: f64,
}

/// The usual accuracy of f32.
pub(super) const TIGHT: Bounds = Bounds { image: 1e-5, gradient: 3e-5 };

/// Largest relative errors of a result, and the parameter with the worst gradient.
pub(super) struct Errors {
    pub(super) image: f64,
    pub(super) gradient: f64,
    pub(super) worst: &'static str,
}

pub(super) fn errors(found: &ParityResult, expected: &ParityResult, kept: &[bool]) -> Errors {
    let steady = |rows: &[[f64; 3]]| -> Vec<f64> {
        rows.iter().zip(kept).filter(|(_, kept)| **kept).flat_map(|(p, _)| *p).collect()
    };
    let images = [(&found.physical, &expected.physical), (&found.radiance, &expected.radiance)];
    let image = images.map(|(a, b)| relative_error(&steady(a), &steady(b)));
    let most = |name| expected.gradients[name].data().iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let overall = expected.gradients.keys().map(&most).fold(0.0, f64::max);
    let (mut gradient, mut worst) = (0.0, "none");
    for (name, theirs) in &expected.gradients {
        let own = most(name).max(1e-9);
        let error = relative_error(found.gradients[name].data(), theirs.data()) * own
            / own.max(MIN_GRADIENT_SHARE * overall);
        if !(error <= gradient) {
            (gradient, worst) = (error, *name);
        }
    }
    Errors { image: image[0].max(image[1]), gradient, worst }
}

/// Cases of one test on one engine. Failures are collected, so that one run reports all of them.
pub(super) struct Suite<'d> {
    device: &'d Device,
    failures: Vec<String>,
    ended: bool,
}

impl<'d> Suite<'d> {
    pub(super) fn on(device: &'d Device) -> Self {
        Self { device, failures: Vec::new(), ended: false }
    }

    /// Compares the engine with the reference.
    pub(super) fn check(&mut self, name: &str, model: &Model, camera: &Camera, bounds: Bounds) {
        let mut case = ParityCase::new(model, camera, BACKGROUND, &LIGHT, 7);
        let kept = stable_pixels(&case, MARGIN);
        case.keep(&kept);
        let expected = reference_result(&case);
        if !expected.is_finite() {
            self.failures.push(format!("{name}: the reference itself is not finite"));
        }
        let found = self.finite(name, &case);
        let Errors { image, gradient, worst } = errors(&found, &expected, &kept);
        let steady = kept.iter().filter(|k| **k).count();
        eprintln!(
            "{name}: image {image:.1e}, gradient {gradient:.1e} ({worst}), {steady}/{} pixels",
            kept.len()
        );
        if steady == 0 {
            self.failures.push(format!("{name}: no pixel is compared"));
        }
        if !(image < bounds.image && gradient < bounds.gradient) {
            self.failures.push(format!("{name}: image {image:e}, gradient {gradient:e} of {worst}"));
        }
    }

    /// For cases where f64 has no result or is too slow: the engine's result must be finite, and the GPU engine must draw the
    /// same Gaussians as the CPU engine and agree with it within `bound`.
    pub(super) fn alike(&mut self, name: &str, model: &Model, camera: &Camera, bound: f64) -> ParityResult {
        let case = ParityCase::new(model, camera, BACKGROUND, &LIGHT, 7);
        let found = self.finite(name, &case);
        if let Device::Gpu(_) = self.device {
            let cpu = cpu_result(&case);
            let drawn = |a: &ParityResult| a.splats.iter().map(|s| s.gaussian).collect::<Vec<_>>();
            if drawn(&found) != drawn(&cpu) {
                self.failures.push(format!("{name}: draws other Gaussians than the CPU engine"));
            }
            let image = relative_error(found.radiance.as_flattened(), cpu.radiance.as_flattened());
            eprintln!("{name}: {image:.1e} from the CPU engine");
            if !(image <= bound) {
                self.failures.push(format!("{name}: {image:e} from the CPU engine"));
            }
        }
        found
    }

    fn finite(&mut self, name: &str, case: &ParityCase<'_>) -> ParityResult {
        let found = result_on(self.device, case);
        if !found.is_finite() {
            self.failures.push(format!("{name}: not finite"));
        }
        found
    }

    pub(super) fn finish(mut self) {
        self.ended = true;
        assert!(self.failures.is_empty(), "{}", self.failures.join("\n"));
    }
}

impl Drop for Suite<'_> {
    fn drop(&mut self) {
        assert!(self.ended || std::thread::panicking(), "a suite must be finished");
    }
}

pub(super) fn result_on(device: &Device, case: &ParityCase<'_>) -> ParityResult {
    match device {
        Device::Cpu => cpu_result(case),
        Device::Gpu(gpu) => gpu_result(gpu, case).unwrap(),
    }
}

#[test]
fn harness_detects_a_changed_image_a_changed_gradient_and_nan() {
    let (plain, camera) = (model(8, 1), in_front((16, 12)));
    let case = ParityCase::new(&plain, &camera, BACKGROUND, &LIGHT, 7);
    let kept = vec![true; 192];
    let expected = reference_result(&case);
    let mut other = plain.clone();
    other.gaussians.field_mut(Field::RoughLogit)[2] += 0.2;
    let found = cpu_result(&ParityCase::new(&other, &camera, BACKGROUND, &LIGHT, 7));
    let e = errors(&found, &expected, &kept);
    assert!(e.image > TIGHT.image && e.gradient > TIGHT.gradient, "{:e} {:e}", e.image, e.gradient);
    let mut poisoned = cpu_result(&case);
    poisoned.radiance[3][1] = f64::NAN;
    assert!(!poisoned.is_finite());
    assert_eq!(errors(&poisoned, &expected, &kept).image, f64::INFINITY);
}
