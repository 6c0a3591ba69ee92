//! Deferred split-sum shading: each pixel once, from the G-buffer (Eq. 16-22).

use std::f64::consts::PI;

use super::array::Array;
use super::gbuffer::GBuffer;
use super::projection::view_vectors;
use super::quadrature::Quadrature;
use super::scene::Parameters;
use super::spherical::{normal_related_sh, real_sh};
use super::tape::{Tape, Var};
use crate::scene::{Camera, Field};

/// What shading makes of P pixels.
pub struct Shaded<'t> {
    /// Unit normals turned to the camera, (P, 3).
    pub normal: Var<'t>,
    /// Ambient occlusion, 1 = open, (P, 1).
    pub ambient_occlusion: Var<'t>,
    /// Diffuse radiance, (P, 3).
    pub diffuse: Var<'t>,
    /// Specular radiance, (P, 3).
    pub specular: Var<'t>,
}

/// Indirect light of each Gaussian, (N, 3): 16 learned SH weights on the low-frequency environment at fixed
/// directions (Eq. 19-20). It is linear in the weights, so it is contracted before blending.
pub fn learned_indirect<'t>(tape: &'t Tape, p: &Parameters<'t>, light: &Quadrature) -> Var<'t> {
    let directions = light.indirect_directions(tape);
    let count = directions.value().shape()[0];
    let matte = tape.input(Array::filled(&[count, 1], 1.0));
    let low = light.prefiltered(p.environment(), directions, matte);
    let basis = real_sh(directions, 3).transposed().matmul(low) * (1.0 / count as f64);
    p.get(Field::Indirect).matmul(basis)
}

/// Shades the G-buffer under the scene's own environment.
pub fn shade<'t>(
    tape: &'t Tape,
    p: &Parameters<'t>,
    buffer: &GBuffer<'t>,
    camera: &Camera,
    light: &Quadrature,
) -> Shaded<'t> {
    let view = tape.input(view_vectors(camera));
    let blended = buffer.normal.normalised();
    let cosine = blended.dot(view);
    let facing = cosine.value().map(|c| if c < 0.0 { -1.0 } else { 1.0 });
    let normal = blended * tape.input(facing);
    let n_dot_v = cosine.abs().clamp(1e-4, 1.0);
    let reflection = (2.0 * n_dot_v * normal - view).normalised();

    let order = (buffer.visibility.value().shape()[1] as f64).sqrt() as usize - 1;
    let ambient_occlusion = buffer.visibility.dot(normal_related_sh(normal, order)).sigmoid();
    let mirror = buffer.visibility.dot(real_sh(reflection, order)).sigmoid();

    let environment = p.environment();
    let base = buffer.albedo * (1.0 - buffer.metal);
    let irradiance = light.irradiance(environment, normal);
    let diffuse = ambient_occlusion * base * (1.0 / PI) * irradiance;

    let f0 = 0.04 * (1.0 - buffer.metal) + buffer.albedo * buffer.metal;
    let split = light.brdf(n_dot_v, buffer.rough);
    let prefiltered = light.prefiltered(environment, reflection, buffer.rough);
    let incoming = mirror * prefiltered + (1.0 - mirror) * buffer.indirect;
    let specular = incoming * (f0 * split.column(0) + split.column(1));
    Shaded { normal, ambient_occlusion, diffuse, specular }
}
