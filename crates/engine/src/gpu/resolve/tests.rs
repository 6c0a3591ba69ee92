//! Frame planes against those of the CPU engine's shader and surfaces.

use super::*;
use crate::cpu::{Pass, SurfaceShader, normalise, surface_at};
use crate::gpu::light::{Constants, LightBuffers};
use crate::gpu::shaders::assert_layout;
use crate::gpu::shading::tests::{Noise, planar_gbuffer, random_pass, random_tables};
use crate::linear_from_srgb;
use relume_compare::relative_error;
use relume_layout::channel::{self, OutgoingRadiance};
use relume_layout::constants::MIN_COVERAGE;
use relume_scene::{DiffuseForm, DisplayRange, ShadeAt, ShadingOptions, VisibilityForm};

const ALL: [Output; 11] = [
    Output::Rgb,
    Output::Albedo,
    Output::Normal,
    Output::Metallic,
    Output::Roughness,
    Output::Visibility,
    Output::Depth,
    Output::Alpha,
    Output::Diffuse,
    Output::Specular,
    Output::Radiance,
];
const DEPTH_SCALE: f32 = 1.7;

/// Expected value of one pixel of one plane.
fn expected(pass: &Pass, shader: &SurfaceShader<'_>, plane: Output, x: usize, y: usize) -> Vec<f32> {
    let alpha = pass.at(x, y, channel::COVERAGE);
    if plane == Output::Alpha {
        return vec![alpha];
    }
    let Some((s, coverage)) = surface_at(pass, x, y) else {
        let nothing = if plane == Output::Depth { f32::INFINITY } else { 0.0 };
        return vec![nothing; plane.channels()];
    };
    let (diffuse, specular): ([f32; 3], [f32; 3]) = match shader.options.shade_at {
        ShadeAt::Pixel => {
            let f = shader.shade(&s);
            (f.diffuse, f.specular)
        }
        ShadeAt::Gaussian => {
            let at = |first: usize, c: usize| pass.at(x, y, first + c) / coverage;
            let specular: [f32; 3] = std::array::from_fn(|c| at(OutgoingRadiance::SPECULAR.start, c));
            (std::array::from_fn(|c| at(OutgoingRadiance::TOTAL.start, c) - specular[c]), specular)
        }
    };
    let (unit, length) = normalise(s.normal);
    let facing: f32 = (0..3).map(|k| unit[k] * s.view[k]).sum();
    let normal = if facing < 0.0 { unit.map(|v| -v) } else { unit };
    let premultiplied = |v: [f32; 3]| v.map(|v| v * coverage).to_vec();
    match plane {
        Output::Rgb => premultiplied(std::array::from_fn(|c| diffuse[c] + specular[c])),
        Output::Diffuse => premultiplied(diffuse),
        Output::Specular => premultiplied(specular),
        Output::Albedo => s.albedo.to_vec(),
        Output::Normal if length > MIN_COVERAGE => normal.to_vec(),
        Output::Normal => vec![0.0; 3],
        Output::Metallic => vec![s.metal],
        Output::Roughness => vec![s.rough],
        Output::Visibility => vec![shader.ambient_occlusion(&s.visibility, normal).clamp(0.0, 1.0)],
        Output::Depth => vec![pass.at(x, y, channel::DEPTH) / coverage * DEPTH_SCALE],
        plane @ (Output::Position
        | Output::Shadow
        | Output::ShadowKey
        | Output::ShadowFill
        | Output::Bounce
        | Output::Contact
        | Output::LampLight
        | Output::LampShadow
        | Output::Confidence
        | Output::Motion
        | Output::MaterialId
        | Output::Cryptomatte) => {
            panic!("no engine renders {plane:?}")
        }
        Output::Alpha => vec![alpha],
        Output::Radiance => channel::RADIANCE
            .map(|c| linear_from_srgb((pass.at(x, y, c) / coverage).clamp(0.0, 1.0)) * coverage)
            .collect(),
    }
}

fn resolved(
    gpu: &Gpu,
    seed: u64,
    options: &ShadingOptions,
    wanted: &[Output],
) -> (Vec<Vec<f32>>, Vec<Vec<f32>>) {
    let sh_degree = 3;
    let mut noise = Noise::new(seed);
    let pass = random_pass(&mut noise, (37, 21), sh_degree, options);
    let tables = random_tables(&mut noise, sh_degree);
    let range = DisplayRange::Unit;
    let shader = SurfaceShader { tables: &tables, options, sh_degree, range };
    let view = CameraUniform::new(&pass.view);
    let gbuffer = gpu.upload("gbuffer", &planar_gbuffer(&pass, &pass.gbuffer, pass.channels)).unwrap();
    let shading = Shading {
        options: *options,
        background: [0.0; 3],
        range,
        light: LightBuffers::upload(gpu, &tables, sh_degree, &[[0.0; 3]; 16]).unwrap(),
        constants: Constants::upload(gpu).unwrap(),
    };
    let planes = Planes::new(gpu, view.pixels(), wanted).unwrap();
    let mut recorder = gpu.record();
    planes.resolve(&mut recorder, &view, &shading, &gbuffer, PixelLight::Tables, DEPTH_SCALE).unwrap();
    recorder.submit().unwrap();
    let mut recorder = gpu.record();
    let tickets = planes.fetch(&mut recorder);
    let arrival = recorder.submit().unwrap().wait_for_data().unwrap();
    let read = |(output, ticket): &(Output, ReadbackTicket<f32>)| (*output, arrival.read(ticket).unwrap());
    let found: Vec<_> = tickets.iter().map(read).collect();
    assert!(found.iter().map(|p| p.0).eq(wanted.iter().copied()));
    let host = wanted.iter().map(|plane| {
        let pixels = (0..view.pixels()).map(|i| (i % 37, i / 37));
        pixels.flat_map(|(x, y)| expected(&pass, &shader, *plane, x, y)).collect()
    });
    (found.into_iter().map(|p| p.1).collect(), host.collect())
}

/// As [`relative_error`], but infinities must be equal and do not count in the scale.
fn plane_error(found: &[f32], host: &[f32]) -> f64 {
    assert!(found.iter().zip(host).all(|(a, b)| !(a.is_infinite() || b.is_infinite()) || a == b));
    let finite = |v: &[f32]| v.iter().map(|v| if v.is_infinite() { 0.0 } else { *v }).collect::<Vec<f32>>();
    relative_error(&finite(found), &finite(host))
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn resolved_outputs_match_the_cpu_engine() {
    let gpu = Gpu::for_tests();
    let forms = [
        (VisibilityForm::Linear, DiffuseForm::Directional, ShadeAt::Pixel),
        (VisibilityForm::Linear, DiffuseForm::Directional, ShadeAt::Gaussian),
        (VisibilityForm::Sigmoid, DiffuseForm::AmbientOcclusion, ShadeAt::Pixel),
        (VisibilityForm::Off, DiffuseForm::Directional, ShadeAt::Pixel),
    ];
    for (seed, (visibility, diffuse, shade_at)) in forms.into_iter().enumerate() {
        let options = ShadingOptions { visibility, diffuse, shade_at, ..ShadingOptions::default() };
        let (found, host) = resolved(&gpu, seed as u64, &options, &ALL);
        for (plane, (found, host)) in ALL.iter().zip(found.iter().zip(&host)) {
            let seen = plane_error(found, host);
            assert!(seen < 2e-5, "{visibility:?} {plane:?}: {seen}");
        }
        let (_, other) = resolved(&gpu, 77, &options, &ALL);
        for (plane, (found, other)) in ALL.iter().zip(found.iter().zip(&other)) {
            let seen = found.iter().zip(other).any(|(a, b)| (a - b).abs() > 1e-3);
            let open = visibility == VisibilityForm::Off && *plane == Output::Visibility;
            assert!(seen || open, "another scene must show in {plane:?}");
        }
    }
}

#[test]
#[ignore = "needs a Vulkan, Metal or DX12 device (see CONTRIBUTING.md)"]
fn requested_outputs_do_not_depend_on_other_outputs() {
    let gpu = Gpu::for_tests();
    let options = ShadingOptions::default();
    let (all, _) = resolved(&gpu, 4, &options, &ALL);
    for wanted in
        [vec![Output::Depth], vec![Output::Specular, Output::Alpha], vec![Output::Alpha, Output::Rgb], vec![]]
    {
        let (found, _) = resolved(&gpu, 4, &options, &wanted);
        for (plane, found) in wanted.iter().zip(&found) {
            let bits = |v: &[f32]| v.iter().map(|v| v.to_bits()).collect::<Vec<u32>>();
            assert_eq!(bits(found), bits(&all[*plane as usize]), "{plane:?}");
        }
    }
}

#[test]
fn uniforms_are_laid_out_as_the_shader_reads_them() {
    assert_layout!(ResolveUniform as "Resolve" in shaders::RESOLVE_1; first, depth_scale, light, pad_a, pad_b);
}
