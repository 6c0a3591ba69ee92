//! Gathered light against the CPU engine.

use super::*;
use crate::cpu::{SkyShadows, Transport, outward_normals};
use crate::gpu::Gpu;
use crate::gpu::light::TablesUniform;
use crate::gpu::model::planar;
use crate::gpu::probes::tests::{ProbeScene, read};
use crate::gpu::shaders::assert_layout;
use crate::gpu::shading::tests::error_of_entries;
use crate::{ProbeSettings, fibonacci_sphere};
use relume_scene::light::{LightTables, rendering_tables};
use relume_scene::{EnvMap, Field, VisibilityForm};

fn tables(sh_degree: usize) -> LightTables {
    let sky = |d: glam::DVec3| [1.0 + d.z.max(0.0) as f32, 0.8 + 0.5 * d.x as f32, (d.y * d.y) as f32];
    rendering_tables(&EnvMap::from_fn(16, 8, sky), sh_degree)
}

struct GatherCase {
    scene: ProbeScene,
    bounces: usize,
}

impl GatherCase {
    /// Gathered light of the device and of the CPU, both from the device's probes.
    fn gathered(&self, gpu: &Gpu) -> (Vec<f32>, Vec<f32>) {
        let ProbeScene { gaussians, prototypes, .. } = &self.scene;
        let probes = self.scene.on_device(gpu, ProbeSettings::default(), &fibonacci_sphere(32));
        let tables = tables(gaussians.visibility_degree());
        let globals: Vec<f32> = prototypes.as_flattened().iter().copied().chain([f32::NAN; 5]).collect();
        let sh_degree = gaussians.visibility_degree();
        let light = LightBuffers::upload(gpu, &tables, sh_degree, &[[0.0; 3]; 16]).unwrap();
        let source = AttributeSource {
            layout: self.scene.layout(),
            params: gpu.upload("params", &planar(gaussians)).unwrap(),
            globals: gpu.upload("globals", &globals).unwrap(),
            gathered: None,
            indirect_basis: None,
        };
        let mut rec = gpu.record();
        let gathered = gather(&mut rec, &probes, &source, &light, self.bounces, None).unwrap();
        rec.submit().unwrap();
        let got = gpu.read(&gathered, 0..6 * gaussians.len()).unwrap();
        let attributes = self.scene.source();
        let transport = Transport::new(&read(gpu, &probes), outward_normals(&attributes));
        let expected = transport.gather(&attributes, &tables, self.bounces);
        (got, expected.as_flattened().to_vec())
    }
}

#[test]
fn host_and_shaders_agree_on_the_structs() {
    for shader in [&shaders::GATHER_EMIT, &shaders::GATHER_BOUNCE] {
        assert_layout!(GatherSize as "GatherSize" in shader; n, n_directions, weight, pad);
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn bounced_light_matches_the_cpu() {
    let gpu = Gpu::for_tests();
    for (bounces, sh_degree) in [(1, 4), (2, 2), (4, 0), (0, 1)] {
        let case = GatherCase { scene: ProbeScene::random(1, 300, sh_degree), bounces };
        let (got, expected) = case.gathered(&gpu);
        let error = error_of_entries(&got, &expected);
        assert!(error < 1e-5, "{bounces} bounces, order {sh_degree}: {error}");
        let lit = expected.iter().filter(|v| **v > 1e-3).count();
        assert!(bounces == 0 || lit > 300, "only {lit} values are lit");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn gathering_without_visibility_and_residuals_matches_the_cpu() {
    let gpu = Gpu::for_tests();
    let mut scene = ProbeScene::random(2, 200, 2);
    scene.options.visibility = VisibilityForm::Off;
    scene.gaussians.field_mut(Field::Residual).fill(0.0);
    let (got, expected) = GatherCase { scene, bounces: 2 }.gathered(&gpu);
    assert!(error_of_entries(&got, &expected) < 1e-5);
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn comparison_detects_other_materials_visibility_and_bounces() {
    let gpu = Gpu::for_tests();
    let (_, expected) = GatherCase { scene: ProbeScene::random(1, 300, 2), bounces: 2 }.gathered(&gpu);
    let plain = || ProbeScene::random(1, 300, 2);
    let albedo = plain().with(|i, g| g.row_mut(Field::Residual, i)[1] += 0.05);
    let metal = plain().with(|i, g| g.row_mut(Field::MetalLogit, i)[0] += 0.1);
    let sky = plain().with(|i, g| g.row_mut(Field::Visibility, i)[2] += 0.1);
    for (name, scene, bounces) in
        [("one more bounce", plain(), 3), ("albedo", albedo, 2), ("metal", metal, 2), ("sky", sky, 2)]
    {
        let error = error_of_entries(&GatherCase { scene, bounces }.gathered(&gpu).0, &expected);
        assert!(error.is_finite() && error > 1e-3, "{name}: {error}");
    }
}

/// Shadows of the sky of the device and of the CPU, both from the device's probes.
fn sky_shadows(gpu: &Gpu, scene: &ProbeScene) -> (Vec<f32>, Vec<f32>) {
    let g = &scene.gaussians;
    let probes = scene.on_device(gpu, ProbeSettings::default(), &fibonacci_sphere(48));
    let tables = tables(g.visibility_degree());
    let light = LightBuffers::upload(gpu, &tables, g.visibility_degree(), &[[0.0; 3]; 16]).unwrap();
    let source = AttributeSource {
        layout: scene.layout(),
        params: gpu.upload("params", &planar(g)).unwrap(),
        globals: gpu.upload("globals", scene.prototypes.as_flattened()).unwrap(),
        gathered: None,
        indirect_basis: None,
    };
    let mut rec = gpu.record();
    let gathered = ungathered(&mut rec, g.len(), None).unwrap();
    add_sky_shadows(&mut rec, &probes, &source, &light, &gathered).unwrap();
    rec.submit().unwrap();
    let got = gpu.read(&gathered, 0..6 * g.len()).unwrap();
    let attributes = scene.source();
    let sky = SkyShadows::new(&attributes, &read(gpu, &probes), &outward_normals(&attributes));
    let expected = sky.added_to(vec![[0.0; 6]; g.len()], &attributes, &tables);
    (got, expected.as_flattened().to_vec())
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn shadows_of_the_sky_match_the_cpu() {
    let gpu = Gpu::for_tests();
    for (seed, sh_degree) in [(1, 4), (2, 2), (3, 0)] {
        let (got, expected) = sky_shadows(&gpu, &ProbeScene::random(seed, 300, sh_degree));
        let error = error_of_entries(&got, &expected);
        assert!(error < 1e-3, "order {sh_degree}: {error}");
    }
    let (_, expected) = sky_shadows(&gpu, &ProbeScene::random(1, 300, 4));
    let turned = ProbeScene::random(1, 300, 4).with(|i, g| g.row_mut(Field::Normal, i)[0] += 0.5);
    let field = ProbeScene::random(1, 300, 4).with(|i, g| g.row_mut(Field::Visibility, i)[7] += 0.9);
    for (name, scene) in [("normal", turned), ("field", field)] {
        let error = error_of_entries(&sky_shadows(&gpu, &scene).0, &expected);
        assert!(error.is_finite() && error > 0.05, "the control, {name}: {error}");
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn no_gaussian_and_one_gaussian_gather_nothing() {
    let gpu = Gpu::for_tests();
    for n in [0, 1] {
        let (got, expected) = GatherCase { scene: ProbeScene::random(1, n, 2), bounces: 2 }.gathered(&gpu);
        assert_eq!((&got, got.iter().all(|v| *v == 0.0)), (&expected, true));
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn light_buffers_of_wrong_size_are_refused() {
    let gpu = Gpu::for_tests();
    let scene = ProbeScene::random(1, 3, 2);
    let probes = scene.on_device(&gpu, ProbeSettings::default(), &fibonacci_sphere(4));
    let (params, short) = (gpu.buffer("params", 400).unwrap(), gpu.buffer("short", 4).unwrap());
    let source = AttributeSource {
        layout: scene.layout(),
        globals: params.clone(),
        params,
        gathered: None,
        indirect_basis: None,
    };
    let layout = TablesUniform { diffuse_n: 2, coefficients: 16, ..bytemuck::Zeroable::zeroed() };
    let values = gpu.buffer("tables", 6 * 4 * 48).unwrap();
    let light = LightBuffers { layout, values, indirect_basis: short.clone() };
    let attempt = |source: &AttributeSource, light: &LightBuffers| {
        gather(&mut gpu.record(), &probes, source, light, 1, None).err()
    };
    assert_eq!(attempt(&source, &light), None);
    let other = AttributeSource { layout: ProbeScene::random(1, 4, 2).layout(), ..source.clone() };
    for wrong in [other, AttributeSource { globals: short, ..source.clone() }] {
        assert!(matches!(attempt(&wrong, &light), Some(DeviceError::Misuse(_))));
    }
    for (diffuse_n, coefficients) in [(1, 16), (3, 16), (2, 17), (2, 0)] {
        let layout = TablesUniform { diffuse_n, coefficients, ..layout };
        let wrong = LightBuffers { layout, ..light.clone() };
        assert!(matches!(attempt(&source, &wrong), Some(DeviceError::Misuse(_))));
    }
}
