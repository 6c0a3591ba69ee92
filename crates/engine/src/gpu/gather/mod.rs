//! Gathered light on the device: the port of [`crate::cpu::Transport`] (docs/MODEL.md, section 6).

use bytemuck::{Pod, Zeroable};

use crate::DeviceError;
use crate::gpu::light::LightBuffers;
use crate::gpu::probes::{ProbeBuffers, direction_weight};
use crate::gpu::{AttributeSource, Buffer, Groups, Recorder, shaders, uniform};

mod lights;
mod sky;
#[cfg(test)]
mod tests;

pub use lights::{GATHERED, LightProbes, ungathered};
pub use sky::add_sky_shadows;

/// `GatherSize` of `shared/gather.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
struct GatherSize {
    n: u32,
    n_directions: u32,
    weight: f32,
    pad: u32,
}

impl GatherSize {
    fn of(probes: &ProbeBuffers) -> Self {
        let n_directions = probes.directions.len();
        let weight = direction_weight(n_directions);
        Self { n: probes.n as u32, n_directions: n_directions as u32, weight, pad: 0 }
    }
}

/// Gathered irradiance and mean blocked radiance after `bounces` rounds: six floats per Gaussian, followed, where `lights`
/// were measured, by their arriving shares for all Gaussians ([`ungathered`]).
///
/// `probes` must belong to the same model. Occlusion does not depend on the light, so one measurement serves any number of
/// lights. The environment is weighted by the visibility field in the current parameters.
///
/// # Errors
/// [`DeviceError::Misuse`] for probes of another model or buffers that are too short, or as
/// [`Gpu::buffer`](crate::gpu::Gpu::buffer).
pub fn gather(
    rec: &mut Recorder<'_>,
    probes: &ProbeBuffers,
    source: &AttributeSource,
    light: &LightBuffers,
    bounces: usize,
    lights: Option<&LightProbes>,
) -> Result<Buffer<f32>, DeviceError> {
    let n = probes.n;
    check(probes, source, light)?;
    rec.stage("gather");
    let gpu = rec.gpu();
    let gathered = ungathered(rec, n, lights)?;
    if bounces == 0 {
        return Ok(gathered);
    }
    let direct: Buffer<[f32; 4]> = gpu.buffer("light from the sky", n)?;
    let diffuse: Buffer<[f32; 4]> = gpu.buffer("diffuse reflectance", n)?;
    let emitted: Buffer<[f32; 4]> = gpu.buffer("light sent back", n)?;
    let size = GatherSize::of(probes);
    let bindings = [
        uniform(&source.layout),
        uniform(&light.layout),
        (&source.params).into(),
        (&source.globals).into(),
        (&light.values).into(),
        (&probes.normals).into(),
        (&direct).into(),
        (&diffuse).into(),
        (&gathered).into(),
    ];
    rec.dispatch(&shaders::GATHER_DIRECT, Groups::Linear(n), &bindings);
    for _ in 0..bounces {
        let bindings =
            [uniform(&size), (&direct).into(), (&diffuse).into(), (&gathered).into(), (&emitted).into()];
        rec.dispatch(&shaders::GATHER_EMIT, Groups::Linear(n), &bindings);
        let bindings = [
            uniform(&size),
            (&probes.directions).into(),
            (&probes.normals).into(),
            (&probes.transmittance).into(),
            (&probes.hit).into(),
            (&emitted).into(),
            (&gathered).into(),
        ];
        rec.dispatch(&shaders::GATHER_BOUNCE, Groups::Linear(n), &bindings);
    }
    Ok(gathered)
}

fn check(probes: &ProbeBuffers, source: &AttributeSource, light: &LightBuffers) -> Result<(), DeviceError> {
    let (edge, coefficients) = (light.layout.diffuse_n as usize, light.layout.coefficients as usize);
    let wrong = if source.layout.n as usize != probes.n {
        Some("probes")
    } else if source.globals.len() < 3 * source.layout.n_scores as usize {
        Some("prototypes")
    } else if edge < 2 || coefficients == 0 {
        Some("light tables' shape")
    } else if light.values.len() < 18 * edge * edge * coefficients {
        Some("light tables")
    } else {
        None
    };
    match wrong {
        Some(what) => Err(DeviceError::Misuse(format!("gathered light: the {what} do not fit"))),
        None => Ok(()),
    }
}
