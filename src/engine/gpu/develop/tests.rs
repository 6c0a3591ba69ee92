//! Pictures against what the CPU engine's shader and surfaces give.

use super::*;
use crate::engine::channel;
use crate::engine::cpu::{self, Pass, Shader, linear_from_srgb, normalise, surface_at, surface_of_row};
use crate::engine::gpu::ViewUniform;
use crate::engine::gpu::light::{Constants, LightBuffers};
use crate::engine::gpu::model::ModelBuffers;
use crate::engine::gpu::shaders::assert_layout;
use crate::engine::gpu::shading::ShadingUniform;
use crate::engine::gpu::shading::tests::{
    Noise, camera_view, error, planar_gbuffer, random_pass, random_tables,
};
use crate::scene::{
    DiffuseAt, DiffuseForm, Field, Gaussians, Model, ShadingOptions, VisibilityForm, sh_count,
};

const ALL: [Plane; 11] = [
    Plane::Rgb,
    Plane::Albedo,
    Plane::Normal,
    Plane::Metallic,
    Plane::Roughness,
    Plane::Visibility,
    Plane::Depth,
    Plane::Alpha,
    Plane::Diffuse,
    Plane::Specular,
    Plane::Radiance,
];
const DEPTH_SCALE: f32 = 1.7;

/// What one pixel of one plane is.
fn expected(pass: &Pass, shader: &Shader<'_>, plane: Plane, x: usize, y: usize) -> Vec<f32> {
    let alpha = pass.at(x, y, channel::COVERAGE);
    if plane == Plane::Alpha {
        return vec![alpha];
    }
    let Some((s, coverage)) = surface_at(pass, x, y) else {
        let nothing = if plane == Plane::Depth { f32::INFINITY } else { 0.0 };
        return vec![nothing; plane.channels()];
    };
    let f = shader.shade(&s);
    let (unit, length) = normalise(s.normal);
    let facing: f32 = (0..3).map(|k| unit[k] * s.view[k]).sum();
    let normal = if facing < 0.0 { unit.map(|v| -v) } else { unit };
    let premultiplied = |v: [f32; 3]| v.map(|v| v * coverage).to_vec();
    match plane {
        Plane::Rgb => premultiplied(std::array::from_fn(|c| f.diffuse[c] + f.specular[c])),
        Plane::Diffuse => premultiplied(f.diffuse),
        Plane::Specular => premultiplied(f.specular),
        Plane::Albedo => s.albedo.to_vec(),
        Plane::Normal if length > cpu::LEAST_COVERAGE => normal.to_vec(),
        Plane::Normal => vec![0.0; 3],
        Plane::Metallic => vec![s.metal],
        Plane::Roughness => vec![s.rough],
        Plane::Visibility => vec![shader.ambient_occlusion(&s.visibility, normal).clamp(0.0, 1.0)],
        Plane::Depth => vec![pass.at(x, y, channel::DEPTH) / coverage * DEPTH_SCALE],
        Plane::Alpha => vec![alpha],
        Plane::Radiance => channel::RADIANCE
            .map(|c| linear_from_srgb((pass.at(x, y, c) / coverage).clamp(0.0, 1.0)) * coverage)
            .collect(),
    }
}

fn developed(
    gpu: &Gpu,
    seed: u64,
    options: &ShadingOptions,
    wanted: &[Plane],
) -> (Vec<Vec<f32>>, Vec<Vec<f32>>) {
    let order = 3;
    let mut noise = Noise::new(seed);
    let pass = random_pass(&mut noise, (37, 21), order, options);
    let tables = random_tables(&mut noise, order);
    let shader = Shader { tables: &tables, options, order };
    let view = ViewUniform::new(&pass.view);
    let gbuffer = gpu.upload("gbuffer", &planar_gbuffer(&pass, &pass.gbuffer, pass.channels)).unwrap();
    let light = LightBuffers::upload(gpu, &tables, order, &[[0.0; 3]; 16]).unwrap();
    let (constants, shading) = (Constants::upload(gpu).unwrap(), ShadingUniform::new(options, [0.0; 3]));
    let job =
        ShadeJob { view: &view, shading: &shading, n_visibility: 16, light: &light, constants: &constants };
    let planes = Planes::new(gpu, view.pixels(), wanted).unwrap();
    let mut recorder = gpu.record();
    planes.develop(&mut recorder, &job, &gbuffer, DEPTH_SCALE).unwrap();
    recorder.submit().unwrap();
    let found = planes.read(gpu).unwrap();
    assert!(found.iter().map(|p| p.0).eq(wanted.iter().copied()));
    let host = wanted.iter().map(|plane| {
        let pixels = (0..view.pixels()).map(|i| (i % 37, i / 37));
        pixels.flat_map(|(x, y)| expected(&pass, &shader, *plane, x, y)).collect()
    });
    (found.into_iter().map(|p| p.1).collect(), host.collect())
}

/// As [`error`], with infinities that must agree.
fn plane_error(found: &[f32], host: &[f32]) -> f32 {
    assert!(found.iter().zip(host).all(|(a, b)| a.is_infinite() == b.is_infinite()));
    let finite = |v: &[f32]| v.iter().map(|v| if v.is_infinite() { 0.0 } else { *v }).collect::<Vec<f32>>();
    error(&finite(found), &finite(host))
}

#[test]
fn every_picture_is_what_the_cpu_engine_gives() {
    let Some(gpu) = Gpu::for_tests() else { return };
    let forms = [
        (VisibilityForm::Linear, DiffuseForm::Directional, DiffuseAt::Pixel),
        (VisibilityForm::Linear, DiffuseForm::Directional, DiffuseAt::Gaussian),
        (VisibilityForm::Sigmoid, DiffuseForm::AmbientOcclusion, DiffuseAt::Pixel),
        (VisibilityForm::Off, DiffuseForm::Directional, DiffuseAt::Pixel),
    ];
    for (seed, (visibility, diffuse, diffuse_at)) in forms.into_iter().enumerate() {
        let options = ShadingOptions { visibility, diffuse, diffuse_at, ..ShadingOptions::default() };
        let (found, host) = developed(&gpu, seed as u64, &options, &ALL);
        for (plane, (found, host)) in ALL.iter().zip(found.iter().zip(&host)) {
            let seen = plane_error(found, host);
            assert!(seen < 2e-5, "{visibility:?} {plane:?}: {seen}");
        }
        let (_, other) = developed(&gpu, 77, &options, &ALL);
        for (plane, (found, other)) in ALL.iter().zip(found.iter().zip(&other)) {
            let seen = found.iter().zip(other).any(|(a, b)| (a - b).abs() > 1e-3);
            let open = visibility == VisibilityForm::Off && *plane == Plane::Visibility;
            assert!(seen || open, "another scene must show in {plane:?}");
        }
    }
}

#[test]
fn planes_that_were_not_asked_for_change_nothing_in_those_that_were() {
    let Some(gpu) = Gpu::for_tests() else { return };
    let options = ShadingOptions::default();
    let (all, _) = developed(&gpu, 4, &options, &ALL);
    for wanted in
        [vec![Plane::Depth], vec![Plane::Specular, Plane::Alpha], vec![Plane::Alpha, Plane::Rgb], vec![]]
    {
        let (found, _) = developed(&gpu, 4, &options, &wanted);
        for (plane, found) in wanted.iter().zip(&found) {
            let bits = |v: &[f32]| v.iter().map(|v| v.to_bits()).collect::<Vec<u32>>();
            assert_eq!(bits(found), bits(&all[*plane as usize]), "{plane:?}");
        }
    }
}

#[test]
fn gaussians_are_shaded_as_the_preview_tier_does() {
    let Some(gpu) = Gpu::for_tests() else { return };
    let (options, order, n) = (ShadingOptions::default(), 2, 300);
    let mut noise = Noise::new(6);
    let tables = random_tables(&mut noise, order);
    let shader = Shader { tables: &tables, options: &options, order };
    let mut gaussians = Gaussians::zeroed(n, 2, order, 0);
    gaussians.field_mut(Field::Mean).iter_mut().for_each(|v| *v = noise.between(-1.0, 1.0));
    let model = Model {
        gaussians,
        prototypes: vec![[0.5; 3]; 2],
        env_raw: vec![[0.0; 3]; 2],
        env_width: 2,
        env_height: 1,
        shading: options,
        world_scale: 1.0,
        world_offset: glam::DVec3::ZERO,
        card: serde_json::Value::Null,
    };
    let groups = 8;
    let rows: Vec<[f32; 4]> = (0..n * groups)
        .map(|i| if i % groups < 5 { noise.rgb(0.0, 1.0) } else { noise.rgb(-0.4, 0.9) })
        .map(|v| [v[0], v[1], v[2], 0.5 * v[0] + 0.2])
        .collect();
    // Every fifth reaches no tile, every seventh is not visible at all.
    let record = |i: usize| SplatRecord {
        n_tiles: u32::from(!i.is_multiple_of(5)),
        flags: u32::from(!i.is_multiple_of(7)),
        ..SplatRecord::zeroed()
    };
    let view = camera_view((16, 16), &options);
    let uniform = ViewUniform::new(&view);
    let light = LightBuffers::upload(&gpu, &tables, order, &[[0.0; 3]; 16]).unwrap();
    let (constants, shading) = (Constants::upload(&gpu).unwrap(), ShadingUniform::new(&options, [0.0; 3]));
    let buffers = ModelBuffers::upload(&gpu, &model).unwrap();
    let splats = gpu.upload("splats", &(0..n).map(record).collect::<Vec<_>>()).unwrap();
    let attributes = gpu.upload("attributes", &rows).unwrap();
    let colours = gpu.upload("colours", &vec![[-7.0f32; 4]; n]).unwrap();
    let n_visibility = sh_count(order);
    let job =
        ShadeJob { view: &uniform, shading: &shading, n_visibility, light: &light, constants: &constants };
    let mut recorder = gpu.record();
    shade_gaussians(&mut recorder, &job, (&buffers.layout, &buffers.params), &splats, &attributes, &colours)
        .unwrap();
    recorder.submit().unwrap();
    let found: Vec<[f32; 4]> = gpu.read(&colours, 0..n).unwrap();
    let host: Vec<[f32; 4]> = (0..n)
        .map(|i| {
            if i % 5 == 0 || i % 7 == 0 {
                return [-7.0; 4];
            }
            let mean: [f32; 3] = model.gaussians.get(Field::Mean, i);
            let row = rows[i * groups..(i + 1) * groups].as_flattened();
            let f = shader.shade(&surface_of_row(row, std::array::from_fn(|k| mean[k] - view.eye[k])));
            [1.0, f.diffuse[0] + f.specular[0], f.diffuse[1] + f.specular[1], f.diffuse[2] + f.specular[2]]
        })
        .collect();
    let seen = error(found.as_flattened(), host.as_flattened());
    assert!(seen < 1e-5, "{seen}");
    let turned: Vec<f32> = (0..n)
        .flat_map(|i| {
            let row = rows[i * groups..(i + 1) * groups].as_flattened();
            shader.shade(&surface_of_row(row, [0.0, -0.1, -1.0])).specular
        })
        .collect();
    let plain: Vec<f32> = found.iter().flat_map(|p| [p[1], p[2], p[3]]).collect();
    assert!(error(&plain, &turned) > 1e-2, "the control: another direction of view shows");
}

#[test]
fn uniforms_are_laid_out_as_the_shader_reads_them() {
    assert_layout!(DevelopUniform as "Develop" in shaders::DEVELOP_1; first, depth_scale, pad_a, pad_b, pad_c);
}
