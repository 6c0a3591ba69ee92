//! Tests of the basics: dispatches, accumulation, transfers, errors, shared shader pieces.

use crate::gpu::model::{LayoutUniform, from_planar, planar};
use crate::gpu::{Buffer, Gpu, GpuOptions, Groups, shaders};
use crate::{DeviceError, RasterCamera, cpu};
use relume_scene::light::sh_eval_with_gradient;
use relume_scene::{Field, Gaussians, ShadingOptions};

fn self_test(gpu: &Gpu, n: usize) -> (Vec<u32>, Vec<f32>) {
    let seen: Buffer<u32> = gpu.buffer("seen", n).unwrap();
    let sums: Buffer<f32> = gpu.buffer("sums", 2).unwrap();
    let mut recorder = gpu.record();
    recorder.clear(&sums);
    recorder.dispatch(&shaders::SELF_TEST, Groups::Linear(n), &[(&seen).into(), (&sums).into()]);
    recorder.submit().unwrap();
    (gpu.read(&seen, 0..n).unwrap(), gpu.read(&sums, 0..2).unwrap())
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn dispatch_processes_each_element_once_and_sums_are_complete() {
    let gpu = Gpu::for_tests();
    for n in [1usize, 255, 256, 257, 100_000] {
        let (seen, sums) = self_test(&gpu, n);
        assert!(seen.iter().enumerate().all(|(i, v)| *v == i as u32), "{n}");
        assert_eq!(sums, [n.div_ceil(2) as f32, (n / 2) as f32]);
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn compare_exchange_sums_equal_float_atomic_sums() {
    let options = GpuOptions { compare_exchange: true, garbage: true, checks: true, ..GpuOptions::default() };
    let gpu = Gpu::with_options(options);
    assert_eq!(self_test(&gpu, 5000).1, [2500.0, 2500.0]);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn dispatches_beyond_65535_workgroups_are_folded() {
    let gpu = Gpu::for_tests();
    let n = 65_536 * 256 + 77;
    let (seen, _) = self_test(&gpu, n);
    assert_eq!((seen[n - 1], seen[65_535 * 256]), (n as u32 - 1, 65_535 * 256));
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn new_test_buffers_hold_garbage_and_partial_access_works() {
    let gpu = Gpu::for_tests();
    let buffer: Buffer<f32> = gpu.buffer("b", 5).unwrap();
    assert_eq!(gpu.read(&buffer, 0..5).unwrap(), [-12345.0; 5]);
    gpu.write(&buffer, 3, &[1.0, 2.0, 3.0]);
    assert_eq!(gpu.read(&buffer, 2..9).unwrap(), [-12345.0, 1.0, 2.0], "nothing is written beyond the end");
    let empty: Buffer<u32> = gpu.buffer("e", 0).unwrap();
    assert!(gpu.read(&empty, 0..4).unwrap().is_empty());
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn buffer_larger_than_a_binding_is_refused_with_sizes() {
    let gpu = Gpu::for_tests();
    let most = gpu.report().max_binding;
    let Err(DeviceError::TooLarge { needs, most: said, .. }) = gpu.buffer::<f32>("huge", most as usize)
    else {
        panic!("was not refused")
    };
    assert_eq!((needs, said), (4 * most, most));
    gpu.healthy().unwrap();
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn memory_use_counts_buffers_until_their_last_handle() {
    let gpu = Gpu::with_options(GpuOptions::default());
    let before = gpu.memory().0;
    let buffer: Buffer<f32> = gpu.buffer("b", 1000).unwrap();
    let handle = buffer.clone();
    drop(buffer);
    assert_eq!(gpu.memory().0 - before, 4000);
    drop(handle);
    assert_eq!(gpu.memory(), (before, before + 4000));
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn stages_are_timed_if_the_device_supports_timestamps() {
    let gpu = Gpu::with_options(GpuOptions::default());
    gpu.measure(true);
    self_test(&gpu, 100_000);
    let timings = gpu.timings();
    assert_eq!(timings.len(), usize::from(gpu.report().timestamps));
    gpu.measure(false);
    assert!(gpu.timings().is_empty());
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn shader_harmonics_and_rotations_match_the_host() {
    let gpu = Gpu::for_tests();
    let given: Vec<[f32; 4]> = vec![
        [0.3, -0.5, 0.81, 0.2],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, -1.0, 1e-20],
        [1.0, 0.0, 0.0, -7.0],
        [-2e-15, 1e-15, 3e-15, 0.5e-15],
        [0.0; 4],
    ];
    let directions = gpu.upload("directions", &given).unwrap();
    let answers: Buffer<[f32; 4]> = gpu.buffer("answers", given.len() * 53).unwrap();
    let mut recorder = gpu.record();
    let bindings = [(&directions).into(), (&answers).into()];
    recorder.dispatch(&shaders::HARMONICS_TEST, Groups::Linear(given.len()), &bindings);
    recorder.submit().unwrap();
    let answers = gpu.read(&answers, 0..given.len() * 53).unwrap();
    for (given, answer) in given.iter().zip(answers.chunks_exact(53)) {
        let (d, _) = cpu::normalise([given[0], given[1], given[2]]);
        let (mut y, mut dy) = ([0.0f32; 49], [[0.0f32; 3]; 49]);
        sh_eval_with_gradient(6, d, &mut y, &mut dy);
        for j in 0..49 {
            let expected = [y[j], dy[j][0], dy[j][1], dy[j][2]];
            let most = expected.iter().fold(1.0f32, |m, v| m.max(v.abs()));
            for k in 0..4 {
                let error = (answer[j][k] - expected[k]).abs();
                assert!(error < 3e-6 * most, "{given:?} {j} {k}: {error}");
            }
        }
        let q = cpu::rotation(*given);
        let g: [[f32; 3]; 3] = std::array::from_fn(|r| std::array::from_fn(|c| q[r][c] * q[r][c]));
        let by = cpu::rotation_backward(*given, &g);
        let most = by.iter().fold(1e-6f32, |m, v| m.max(v.abs()));
        for k in 0..3 {
            (0..3).for_each(|r| assert!((answer[49 + k][r] - q[r][k]).abs() < 1e-6));
        }
        (0..4).for_each(|k| {
            assert!((answer[52][k] - by[k]).abs() < 1e-4 * most, "{given:?} {:?} {by:?}", answer[52])
        });
    }
}

#[test]
fn model_round_trips_through_the_planar_layout() {
    let mut g = Gaussians::zeroed(3, 5, 2, 1);
    let mut next = 0.0;
    for (_, _, data) in g.fields_mut() {
        data.iter_mut().for_each(|v| {
            *v = next;
            next += 1.0;
        });
    }
    let layout = LayoutUniform::new(&g, &ShadingOptions::default());
    let flat = planar(&g);
    assert_eq!(flat[layout.start(Field::ProtoLogits) + 5], g.row(Field::ProtoLogits, 1)[0]);
    assert_eq!(flat[layout.start(Field::Radiance) + 2 * 12 + 3], g.row(Field::Radiance, 2)[3]);
    let mut back = Gaussians::zeroed(3, 5, 2, 1);
    from_planar(&flat, &mut back);
    assert_eq!(back, g);
}

#[test]
fn camera_uniform_matches_the_cpu_raster_camera() {
    let camera = relume_scene::Camera {
        width: 37,
        height: 21,
        fx: 40.0,
        fy: 41.0,
        cx: 18.0,
        cy: 11.0,
        rotation: glam::DMat3::from_rotation_z(0.3),
        translation: glam::DVec3::new(0.1, 0.2, 3.0),
    };
    let view = RasterCamera::new(&camera, &ShadingOptions::default());
    let uniform = super::CameraUniform::new(&view);
    assert_eq!((uniform.tiles, uniform.n_pixels), ([3, 2], 777));
    assert_eq!(uniform.rotation[1][..3], view.rotation[1]);
}
