//! Shadows of the sky in single directions: the port of [`crate::cpu::SkyShadows`].

use crate::DeviceError;
use crate::gpu::gather::{GatherSize, check};
use crate::gpu::light::LightBuffers;
use crate::gpu::probes::ProbeBuffers;
use crate::gpu::{AttributeSource, Buffer, Groups, Recorder, shaders, uniform};

/// Adds the shadows of the sky under `light` to the irradiance in `gathered`, six floats per Gaussian. The visibility field in the current
/// parameters may differ from that of `probes`.
///
/// # Errors
/// [`DeviceError::Misuse`] for probes of another model or buffers that are too short, or as
/// [`Gpu::buffer`](crate::gpu::Gpu::buffer).
pub fn add_sky_shadows(
    rec: &mut Recorder<'_>,
    probes: &ProbeBuffers,
    source: &AttributeSource,
    light: &LightBuffers,
    gathered: &Buffer<f32>,
) -> Result<(), DeviceError> {
    check(probes, source, light)?;
    if gathered.len() < 6 * probes.n || light.values.len() < light.layout.first_light as usize {
        return Err(DeviceError::Misuse("shadows of the sky: the buffers do not fit".to_owned()));
    }
    rec.stage("sky shadows");
    let n_directions = probes.directions.len();
    let radiance: Buffer<[f32; 4]> = rec.gpu().buffer("light by direction", n_directions)?;
    let bindings =
        [uniform(&light.layout), (&light.values).into(), (&probes.directions).into(), (&radiance).into()];
    rec.dispatch(&shaders::SKY_RADIANCE, Groups::Linear(n_directions), &bindings);
    let size = GatherSize::of(probes);
    let bindings = [
        uniform(&size),
        uniform(&source.layout),
        uniform(&light.layout),
        (&source.params).into(),
        (&light.values).into(),
        (&probes.directions).into(),
        (&probes.normals).into(),
        (&probes.transmittance).into(),
        (&radiance).into(),
        gathered.into(),
        (&probes.basis).into(),
        (&source.globals).into(),
    ];
    rec.dispatch(&shaders::SKY_SHADOWS, Groups::Linear(probes.n), &bindings);
    Ok(())
}
