//! The probes against the CPU engine.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::cpu::{self, AttributeSource, outward_normals};
use crate::gpu::model::{LayoutUniform, planar};
use crate::gpu::probes::sweep::{Axes, CellCounts, Flat, Occluder, ProbeStart, Projection, Sweep, Sweeper};
use crate::gpu::probes::{ProbeBuffers, measure};
use crate::gpu::shaders::assert_layout;
use crate::gpu::{Buffer, Gpu, shaders};
use crate::{DeviceError, ProbeSettings, fibonacci_sphere};
use relume_compare::largest_difference;
use relume_layout::constants::NO_HIT;
use relume_scene::{Field, Gaussians, ShadingOptions, sh_count};

/// Largest difference of a transmittance, or of a coefficient relative to the largest coefficient.
const TOLERANCE: f32 = 1e-4;
/// Share of entries that may differ by more: rounding decides whether an occluder exactly at the limit of its clearance,
/// reach or opacity counts, and which of two equally strong occluders is the strongest. Measured 3e-6 on 100,000 Gaussians;
/// 1.4e-3 on needles, whose exponents lose digits on the CPU.
const FLIPPED: f64 = 0.001;
const FLIPPED_NEEDLES: f64 = 0.005;

/// A model with the additional input of the CPU engine.
pub(in crate::gpu) struct ProbeScene {
    pub(in crate::gpu) gaussians: Gaussians,
    pub(in crate::gpu) prototypes: Vec<[f32; 3]>,
    pub(in crate::gpu) options: ShadingOptions,
}

impl ProbeScene {
    pub(in crate::gpu) fn random(seed: u64, n: usize, sh_degree: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut uniform = move |lo: f32, hi: f32| lo + (hi - lo) * rng.random::<f32>();
        let mut gaussians = Gaussians::zeroed(n, 4, sh_degree, 1);
        for field in Field::ALL {
            let (lo, hi) = match field {
                Field::LogScale => (-4.0, -1.2),
                Field::OpacityLogit => (-3.0, 4.0),
                Field::Visibility => (-0.3, 0.3),
                Field::SamplingRate => (5.0, 60.0),
                _ => (-1.0, 1.0),
            };
            gaussians.field_mut(field).iter_mut().for_each(|v| *v = uniform(lo, hi));
        }
        let prototypes = (0..4).map(|_| [uniform(-0.2, 1.2), uniform(0.0, 1.0), uniform(0.0, 1.0)]).collect();
        Self { gaussians, prototypes, options: ShadingOptions::default() }
    }

    pub(in crate::gpu) fn with(mut self, change: impl Fn(usize, &mut Gaussians)) -> Self {
        (0..self.gaussians.len()).for_each(|i| change(i, &mut self.gaussians));
        self
    }

    pub(in crate::gpu) fn source(&self) -> AttributeSource<'_> {
        AttributeSource::new(&self.gaussians, &self.prototypes, &self.options)
    }

    pub(in crate::gpu) fn layout(&self) -> LayoutUniform {
        LayoutUniform::new(&self.gaussians, &self.options)
    }

    pub(in crate::gpu) fn on_device(
        &self,
        gpu: &Gpu,
        settings: ProbeSettings,
        directions: &[[f32; 3]],
    ) -> ProbeBuffers {
        let params = gpu.upload("params", &planar(&self.gaussians)).unwrap();
        let sh_degree = self.gaussians.visibility_degree();
        measure(gpu, &params, &self.layout(), settings, directions, sh_degree).unwrap()
    }
}

/// The device's transmittances and hits in the form of the CPU engine.
pub(in crate::gpu) fn read(gpu: &Gpu, probes: &ProbeBuffers) -> cpu::Probes {
    let directions: Vec<[f32; 4]> = gpu.read(&probes.directions, 0..probes.directions.len()).unwrap();
    let n = probes.n.max(1);
    let transmittance = gpu.read(&probes.transmittance, 0..probes.transmittance.len()).unwrap();
    let hit = gpu.read(&probes.hit, 0..probes.hit.len()).unwrap();
    cpu::Probes {
        directions: directions.iter().map(|d| [d[0], d[1], d[2]]).collect(),
        transmittance: transmittance.chunks(n).map(<[f32]>::to_vec).collect(),
        hit: hit.chunks(n).map(<[u32]>::to_vec).collect(),
    }
}

/// Shares of transmittances and of hits that differ.
fn differing(a: &cpu::Probes, b: &cpu::Probes) -> [f64; 2] {
    let (ta, tb) = (a.transmittance.concat(), b.transmittance.concat());
    let (ha, hb) = (a.hit.concat(), b.hit.concat());
    assert_eq!((ta.len(), ha.len()), (tb.len(), hb.len()));
    let far = ta.iter().zip(&tb).filter(|(a, b)| !((*a - *b).abs() <= TOLERANCE)).count();
    let other = ha.iter().zip(&hb).filter(|(a, b)| a != b).count();
    [far, other].map(|count| count as f64 / ta.len().max(1) as f64)
}

/// Directions spread over the sphere, and the axes.
fn directions() -> Vec<[f32; 3]> {
    let mut all = fibonacci_sphere(24);
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            all.push(std::array::from_fn(|k| if k == axis { sign } else { 0.0 }));
        }
    }
    all
}

/// Asserts parity of a scene; returns the share of directions that are partly blocked and have a hit.
fn assert_parity(gpu: &Gpu, scene: &ProbeScene, settings: ProbeSettings) -> f64 {
    assert_parity_within(gpu, scene, settings, FLIPPED)
}

fn assert_parity_within(gpu: &Gpu, scene: &ProbeScene, settings: ProbeSettings, flipped: f64) -> f64 {
    let expected = cpu::Probes::measure(&scene.source(), directions(), settings);
    let buffers = scene.on_device(gpu, settings, &directions());
    let got = read(gpu, &buffers);
    let shares = differing(&expected, &got);
    assert!(shares.iter().all(|s| *s <= flipped), "{shares:?} differ");
    let normals = gpu.read(&buffers.normals, 0..scene.gaussians.len()).unwrap();
    for (a, b) in outward_normals(&scene.source()).iter().zip(&normals) {
        assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-5 || a[k].is_nan()), "{a:?} {b:?}");
    }
    let hits = expected.hit.concat();
    hits.iter().filter(|h| **h != NO_HIT).count() as f64 / hits.len().max(1) as f64
}

#[test]
fn host_and_shaders_agree_on_the_structs() {
    for shader in [&shaders::PROBE_FLATTEN, &shaders::PROBE_EMIT, &shaders::PROBE_WALK] {
        assert_layout!(Sweep as "Sweep" in shader; n, n_directions, direction_ix, side, n_instances, clearance, reach, pad);
    }
    assert_layout!(ProbeStart as "ProbeStart" in shaders::PROBE_PREPARE; offset, lift, bias, pad);
    assert_layout!(Projection as "Projection" in shaders::PROBE_COEFFICIENTS; n, n_directions, n_coefficients, weight);
    assert_eq!(shaders::PROBE_FLATTEN.layout("Frame").unwrap().size, size_of::<Axes>());
    assert_eq!(shaders::PROBE_FLATTEN.layout("Occluder").unwrap().size, size_of::<Occluder>());
    assert_eq!(shaders::PROBE_FLATTEN.layout("Flat").unwrap().size, size_of::<Flat>());
    assert_eq!(shaders::TILE_OFFSETS.layout("TileCounts").unwrap().size, size_of::<CellCounts>());
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn probes_of_a_random_scene_match_the_cpu() {
    let gpu = Gpu::for_tests();
    let scene = ProbeScene::random(1, 400, 4);
    let blocked = assert_parity(&gpu, &scene, ProbeSettings::default());
    assert!(
        (0.2..0.95).contains(&blocked),
        "{blocked} of the directions are blocked: the test has little to see"
    );
    let settings = ProbeSettings { offset: 0.5, lift: 0.01, clearance: 1.0, bias: 0.05, reach: 0.6 };
    assert_parity(&gpu, &scene, settings);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn the_comparison_notices_other_settings_and_another_scene() {
    let gpu = Gpu::for_tests();
    let scene = ProbeScene::random(1, 400, 2);
    let expected = cpu::Probes::measure(&scene.source(), directions(), ProbeSettings::default());
    let default = ProbeSettings::default();
    for settings in [
        ProbeSettings { bias: 0.1, ..default },
        ProbeSettings { offset: 0.0, ..default },
        ProbeSettings { clearance: 1.0, ..default },
        ProbeSettings { lift: 0.1, ..default },
        ProbeSettings { reach: 0.5, ..default },
    ] {
        let got = read(&gpu, &scene.on_device(&gpu, settings, &directions()));
        let shares = differing(&expected, &got);
        assert!(shares.iter().all(|s| *s > 20.0 * FLIPPED), "{settings:?}: only {shares:?} differ");
    }
    let other = scene.with(|i, g| {
        if i == 7 {
            g.row_mut(Field::LogScale, i).fill(0.0);
            g.row_mut(Field::OpacityLogit, i).fill(5.0);
        }
    });
    let got = read(&gpu, &other.on_device(&gpu, default, &directions()));
    assert!(differing(&expected, &got)[0] > 20.0 * FLIPPED);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn coefficients_equal_the_projected_transmittances() {
    let gpu = Gpu::for_tests();
    for (sh_degree, n) in [(0, 70), (1, 300), (3, 257), (6, 300)] {
        let scene = ProbeScene::random(3, n, sh_degree);
        let buffers = scene.on_device(&gpu, ProbeSettings::default(), &directions());
        let got = gpu.read(&buffers.coefficients, 0..n * sh_count(sh_degree)).unwrap();
        let expected = read(&gpu, &buffers).coefficients(sh_degree);
        let most = expected.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        let error = largest_difference(&got, &expected);
        assert!(error < 1e-5 * f64::from(most), "order {sh_degree}: {error} of {most}");
        // Against the CPU's own measurement: whole rows differ where rounding flipped a transmittance.
        let cpu = cpu::Probes::measure(&scene.source(), directions(), ProbeSettings::default());
        let cpu = cpu.coefficients(sh_degree);
        let far = got.iter().zip(&cpu).filter(|(a, b)| !((*a - *b).abs() <= TOLERANCE * most)).count();
        assert!(far as f64 <= 5.0 * FLIPPED * got.len() as f64, "order {sh_degree}: {far} of {}", got.len());
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn grid_size_does_not_change_the_measurement() {
    let gpu = Gpu::for_tests();
    let scene = ProbeScene::random(5, 300, 2);
    let params = gpu.upload("params", &planar(&scene.gaussians)).unwrap();
    let measured = |side: usize, entries: usize| {
        let model = scene.layout();
        let mut sweeper = Sweeper::new(&gpu, &model, ProbeSettings::default(), &directions(), 2).unwrap();
        let buffers = sweeper.measure(&params, &model, side, entries).unwrap();
        (read(&gpu, &buffers), sweeper.sweep.side)
    };
    let (expected, _) = measured(1, usize::MAX);
    for (side, entries, becomes) in
        [(17, usize::MAX, 17), (256, usize::MAX, 256), (256, 4000, 0), (40, 0, 1), (3, 0, 1)]
    {
        let (got, side) = measured(side, entries);
        assert!(side == becomes || becomes == 0 && (2..256).contains(&side), "{side}");
        assert_eq!(differing(&expected, &got), [0.0; 2], "{side} cells along an edge");
        assert_eq!(expected.transmittance, got.transmittance);
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn probes_work_with_zero_or_one_gaussian_and_no_direction() {
    let gpu = Gpu::for_tests();
    assert_parity(&gpu, &ProbeScene::random(1, 0, 2), ProbeSettings::default());
    let one = ProbeScene::random(1, 1, 2);
    assert_eq!(assert_parity(&gpu, &one, ProbeSettings::default()), 0.0, "nothing hides itself");
    let buffers = one.on_device(&gpu, ProbeSettings::default(), &[]);
    assert_eq!(gpu.read(&buffers.coefficients, 0..9).unwrap(), [0.0; 9]);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn probes_of_flat_and_degenerate_scenes_match_the_cpu() {
    let gpu = Gpu::for_tests();
    for fixed in [&[2][..], &[0, 1], &[0, 1, 2]] {
        let scene = ProbeScene::random(11, 300, 2).with(|i, g| {
            fixed.iter().for_each(|k| g.row_mut(Field::Mean, i)[*k] = 0.25);
        });
        assert_parity(&gpu, &scene, ProbeSettings::default());
    }
    // Two sheets that face and hide each other.
    let scene = ProbeScene::random(12, 400, 2).with(|i, g| {
        g.row_mut(Field::Mean, i)[2] = if i % 2 == 0 { 0.4 } else { -0.4 };
        g.row_mut(Field::LogScale, i).copy_from_slice(&[-1.5, -1.7, -5.0]);
        g.row_mut(Field::Quaternion, i).copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
    });
    assert!(assert_parity(&gpu, &scene, ProbeSettings::default()) > 0.2);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn distant_gaussian_does_not_change_results_or_grid_bounds() {
    let gpu = Gpu::for_tests();
    let scene = ProbeScene::random(1, 400, 2).with(|i, g| {
        if i == 100 {
            g.row_mut(Field::Mean, i).copy_from_slice(&[3e4, -1e4, 2e4]);
        }
    });
    assert_parity(&gpu, &scene, ProbeSettings::default());
    let params = gpu.upload("params", &planar(&scene.gaussians)).unwrap();
    let model = scene.layout();
    let mut sweeper = Sweeper::new(&gpu, &model, ProbeSettings::default(), &directions(), 2).unwrap();
    sweeper.measure(&params, &model, 20, usize::MAX).unwrap();
    let bounds = gpu.read(&sweeper.bounds, 0..8).unwrap();
    assert!(bounds.iter().all(|b| b.abs() < 3.0), "{bounds:?}");
    assert!((0..3).all(|k| bounds[k] < -0.9 && bounds[4 + k] > 0.9), "{bounds:?}");
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn probes_of_elongated_and_flat_gaussians_match_the_cpu() {
    let gpu = Gpu::for_tests();
    for (scales, aligned) in [
        ([-1.0, -6.0, -6.0], false),
        ([-1.0, -1.0, -7.0], false),
        ([-1.5, -1.5, -30.0], true),
        ([-1.0, -8.0, -8.0], true),
    ] {
        let scene = ProbeScene::random(21, 300, 2).with(|i, g| {
            g.row_mut(Field::LogScale, i).copy_from_slice(&scales);
            if aligned {
                g.row_mut(Field::Quaternion, i).copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
            }
        });
        assert_parity_within(&gpu, &scene, ProbeSettings::default(), FLIPPED_NEEDLES);
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn transparent_distant_and_nan_gaussians_do_not_occlude() {
    let gpu = Gpu::for_tests();
    let transparent = ProbeScene::random(31, 300, 2).with(|i, g| g.row_mut(Field::OpacityLogit, i)[0] = -6.0);
    assert_eq!(assert_parity(&gpu, &transparent, ProbeSettings::default()), 0.0);
    let half = ProbeScene::random(32, 300, 2).with(|i, g| {
        if i % 2 == 0 {
            g.row_mut(Field::OpacityLogit, i)[0] = -6.0;
        }
    });
    let all = assert_parity(&gpu, &half, ProbeSettings::default());
    let near = assert_parity(&gpu, &half, ProbeSettings { reach: 0.3, ..ProbeSettings::default() });
    assert!(0.0 < near && near < all, "{near} {all}");
    let broken = ProbeScene::random(33, 300, 2).with(|i, g| match i % 12 {
        0 => g.row_mut(Field::Mean, i)[1] = f32::NAN,
        1 => g.row_mut(Field::LogScale, i)[0] = f32::NAN,
        3 => g.row_mut(Field::OpacityLogit, i)[0] = f32::NAN,
        4 => {
            g.row_mut(Field::LogScale, i)[2] = 200.0;
            // Along the axes: perpendicular to such a long axis, rounding alone would move the query.
            g.row_mut(Field::Quaternion, i).copy_from_slice(&[2.0, 0.0, 0.0, 0.0]);
        }
        5 => g.row_mut(Field::Quaternion, i).fill(0.0),
        _ => {}
    });
    assert!(assert_parity(&gpu, &broken, ProbeSettings::default()) > 0.1);
    // An invalid rotation: the CPU uses the identity, the device skips the Gaussian, as in images.
    let turned = ProbeScene::random(34, 300, 2).with(|i, g| {
        if i % 2 == 0 {
            g.row_mut(Field::Quaternion, i)[2] = f32::NAN;
        }
    });
    let seen = read(&gpu, &turned.on_device(&gpu, ProbeSettings::default(), &directions()));
    assert!(seen.hit.iter().flatten().all(|h| *h == NO_HIT || h % 2 == 1));
    assert!(seen.transmittance.iter().flatten().all(|t| (0.0..=1.0).contains(t)));
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn storing_probes_changes_only_the_visibility_field() {
    let gpu = Gpu::for_tests();
    let scene = ProbeScene::random(41, 100, 3);
    let params = gpu.upload("params", &planar(&scene.gaussians)).unwrap();
    let buffers = scene.on_device(&gpu, ProbeSettings::default(), &directions());
    let mut rec = gpu.record();
    buffers.store(&mut rec, &params, &scene.layout()).unwrap();
    rec.submit().unwrap();
    let mut expected = planar(&scene.gaussians);
    let coefficients = gpu.read(&buffers.coefficients, 0..1600).unwrap();
    let first = scene.layout().start(Field::Visibility);
    assert_ne!(expected[first..first + 1600], coefficients);
    expected[first..first + 1600].copy_from_slice(&coefficients);
    assert_eq!(gpu.read(&params, 0..expected.len()).unwrap(), expected);
    let other = ProbeScene::random(41, 100, 2).layout();
    assert!(buffers.store(&mut gpu.record(), &params, &other).is_err());
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn too_large_measurement_is_refused_with_its_size() {
    let gpu = Gpu::for_tests();
    let params: Buffer<f32> = gpu.buffer("params", 4).unwrap();
    let model = LayoutUniform { n: 1 << 30, ..ProbeScene::random(1, 1, 0).layout() };
    let up = [[0.0, 0.0, 1.0]; 2];
    let Err(DeviceError::TooLarge { needs, what, .. }) =
        measure(&gpu, &params, &model, ProbeSettings::default(), &up, 0)
    else {
        panic!("was not refused")
    };
    assert!(needs == 8 << 30 && what.contains("2 directions"), "{needs} {what}");
    let model = ProbeScene::random(1, 1, 0).layout();
    assert!(measure(&gpu, &params, &model, ProbeSettings::default(), &up, 7).is_err());
}
