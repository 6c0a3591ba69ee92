//! Arriving share of each dominant light at each Gaussian: the port of [`crate::cpu::arriving`].

use bytemuck::{Pod, Zeroable};

use crate::gpu::model::LayoutUniform;
use crate::gpu::{Buffer, Gpu, Groups, Recorder, probes, shaders, uniform};
use crate::{DeviceError, ProbeSettings, towards_light};
use relume_scene::{MAX_LIGHTS, ShadingOptions, SplitLight, VisibilityForm};

/// Floats of gathered light per Gaussian.
pub const GATHERED: usize = 6;

/// `LightShares` of `light_shares.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(super) struct LightShares {
    pub(super) n_directions: [u32; MAX_LIGHTS],
    pub(super) n: u32,
    pub(super) pad_a: u32,
    pub(super) pad_b: u32,
    pub(super) pad_c: u32,
}

/// Measured transmittance towards the lights of an environment.
pub struct LightProbes {
    n_directions: [u32; MAX_LIGHTS],
    /// `[direction][Gaussian]`.
    transmittance: Buffer<f32>,
}

impl LightProbes {
    /// Measures `lights` from every Gaussian of the model in `params`. `None` without lights and for the visibility form
    /// `Off`: the lights then arrive unshadowed.
    ///
    /// # Errors
    /// As [`probes::measure`].
    pub fn measure(
        gpu: &Gpu,
        params: &Buffer<f32>,
        model: &LayoutUniform,
        options: &ShadingOptions,
        lights: &[SplitLight],
    ) -> Result<Option<Self>, DeviceError> {
        if lights.is_empty() || options.visibility == VisibilityForm::Off {
            return Ok(None);
        }
        let towards: Vec<Vec<[f32; 3]>> = lights.iter().take(MAX_LIGHTS).map(towards_light).collect();
        let mut n_directions = [0; MAX_LIGHTS];
        n_directions.iter_mut().zip(&towards).for_each(|(n, d)| *n = d.len() as u32);
        let settings = ProbeSettings::of(options);
        let probes = probes::measure(gpu, params, model, settings, &towards.concat(), 0)?;
        Ok(Some(Self { n_directions, transmittance: probes.transmittance }))
    }
}

/// Measured light of `n` Gaussians before light is gathered: zeros, followed by the arriving shares of the lights of
/// `probes`.
///
/// # Errors
/// As [`Gpu::buffer`].
pub fn ungathered(
    rec: &mut Recorder<'_>,
    n: usize,
    probes: Option<&LightProbes>,
) -> Result<Buffer<f32>, DeviceError> {
    let floats = if probes.is_some() { GATHERED + MAX_LIGHTS } else { GATHERED };
    let gathered: Buffer<f32> = rec.gpu().buffer("gathered light", floats * n)?;
    rec.clear(&gathered);
    if let Some(probes) = probes {
        let shares = LightShares { n_directions: probes.n_directions, n: n as u32, ..LightShares::zeroed() };
        let bindings = [uniform(&shares), (&probes.transmittance).into(), (&gathered).into()];
        rec.dispatch(&shaders::LIGHT_SHARES, Groups::Linear(n), &bindings);
    }
    Ok(gathered)
}
