//! Converts a G-buffer to the planes of a frame.

use std::collections::BTreeMap;

use glam::DVec3;
use rayon::prelude::*;

use crate::cpu::{Pass, Surface, SurfaceShader, normalise, surface_at};
use crate::{Frame, linear_from_srgb};
use relume_layout::channel::{self, OutgoingRadiance};
use relume_layout::constants::MIN_COVERAGE;
use relume_scene::light::{Material, Reflector};
use relume_scene::{Output, ShadingOptions};

/// Converts a G-buffer to the requested planes. `light` shades the surface in pixel (x, y); it is called only where an output
/// contains light.
pub fn resolve(
    pass: &Pass,
    shader: &SurfaceShader<'_>,
    outputs: &[Output],
    depth_scale: f32,
    light: impl Fn((usize, usize), &Surface) -> OutgoingRadiance + Sync,
) -> Frame {
    let (w, h) = (pass.view.width, pass.view.height);
    let stride: usize = outputs.iter().map(|o| o.channels()).sum();
    let mut pixels = vec![0.0f32; w * h * stride];
    pixels.par_chunks_mut(w * stride).enumerate().for_each(|(y, row)| {
        for (x, out) in row.chunks_exact_mut(stride).enumerate() {
            write_pixel(pass, shader, outputs, depth_scale, (x, y), &light, out);
        }
    });
    let mut planes = BTreeMap::new();
    let mut first = 0;
    for output in outputs {
        let n = output.channels();
        let plane = pixels.chunks_exact(stride).flat_map(|p| p[first..first + n].iter().copied()).collect();
        planes.insert(*output, plane);
        first += n;
    }
    Frame { width: w as u32, height: h as u32, planes }
}

fn write_pixel(
    pass: &Pass,
    shader: &SurfaceShader<'_>,
    outputs: &[Output],
    depth_scale: f32,
    (x, y): (usize, usize),
    light: &impl Fn((usize, usize), &Surface) -> OutgoingRadiance,
    out: &mut [f32],
) {
    let surface = surface_at(pass, x, y);
    let is_shaded = outputs.iter().any(|o| matches!(o, Output::Rgb | Output::Diffuse | Output::Specular));
    let shaded = surface.as_ref().filter(|_| is_shaded).map(|(s, coverage)| (light((x, y), s), *coverage));
    let mut first = 0;
    for output in outputs {
        let target = &mut out[first..first + output.channels()];
        first += output.channels();
        match output {
            Output::Alpha => target[0] = pass.at(x, y, channel::COVERAGE),
            Output::Depth if surface.is_none() => target[0] = f32::INFINITY,
            Output::Rgb | Output::Diffuse | Output::Specular => {
                let Some((s, coverage)) = &shaded else { continue };
                let part = |c: usize| match output {
                    Output::Diffuse => s.diffuse[c],
                    Output::Specular => s.specular[c],
                    _ => s.diffuse[c] + s.specular[c],
                };
                (0..3).for_each(|c| target[c] = part(c) * coverage);
            }
            _ => {
                if let Some((s, coverage)) = &surface {
                    write_attribute(pass, shader, *output, (s, *coverage), depth_scale, (x, y), target);
                }
            }
        }
    }
}

fn write_attribute(
    pass: &Pass,
    shader: &SurfaceShader<'_>,
    output: Output,
    (surface, coverage): (&Surface, f32),
    depth_scale: f32,
    (x, y): (usize, usize),
    target: &mut [f32],
) {
    let (unit, length) = normalise(surface.normal);
    let facing: f32 = (0..3).map(|k| unit[k] * surface.view[k]).sum();
    let normal = if facing < 0.0 { unit.map(|v| -v) } else { unit };
    match output {
        Output::Albedo => target.copy_from_slice(&surface.albedo),
        Output::Normal if length > MIN_COVERAGE => target.copy_from_slice(&normal),
        Output::Metallic => target[0] = surface.metal,
        Output::Roughness => target[0] = surface.rough,
        Output::Visibility => {
            target[0] = shader.ambient_occlusion(&surface.visibility, normal).clamp(0.0, 1.0)
        }
        Output::Depth => target[0] = pass.at(x, y, channel::DEPTH) / coverage * depth_scale,
        Output::Radiance => {
            for (k, t) in target.iter_mut().enumerate() {
                let shown = (pass.at(x, y, channel::RADIANCE.start + k) / coverage).clamp(0.0, 1.0);
                *t = linear_from_srgb(shown) * coverage;
            }
        }
        _ => {}
    }
}

/// The BRDF of a surface in the forward model `options`, with its normal turned to the camera.
pub fn reflector(surface: &Surface, options: &ShadingOptions) -> Reflector {
    let vector = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
    let view = vector(surface.view).normalize_or(DVec3::Z);
    let normal = vector(surface.normal).normalize_or(view);
    let facing = if normal.dot(view) < 0.0 { -normal } else { normal };
    let material = Material {
        albedo: surface.albedo,
        metal: surface.metal,
        rough: surface.rough,
        conserves_energy: options.conserves_energy,
    };
    Reflector::new(facing, view, material)
}
