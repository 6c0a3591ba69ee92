//! The Monte-Carlo tier: Monte-Carlo integration over the environment for each pixel, with a ray through the Gaussians in every
//! sampled direction. Blocked directions contribute the gathered light, as in the standard tier.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::cpu::{
    AttributeSource, OccluderBvh, Pass, Surface, SurfaceShader, reflector, resolve, surface_point,
};
use crate::{Frame, FrameJob};
use relume_layout::channel::{Channels, OutgoingRadiance};
use relume_layout::constants::EarlyStop;
use relume_scene::Field;
use relume_scene::light::{EnvSampler, SampleCounts, estimate};

/// Upper bound of a radiance, so that a frame stays finite in f32 even with samples of an extreme light.
const MAX_RADIANCE: f64 = 1e36;

/// Renders every pixel with `samples` directions. The seed is the only source of randomness. `pixels_before` is the number of the
/// frame's pixels before the first pixel of the job, so that no two pixels have the same samples.
pub(super) fn render(
    job: &FrameJob<'_>,
    (source, shader): (&AttributeSource<'_>, &SurfaceShader<'_>),
    (environment, samples): (&EnvSampler, u32),
    (seed, pixels_before): (u64, u64),
    occluders: &OccluderBvh,
) -> Frame {
    let view = job.view;
    let coefficients = source.gaussians.width(Field::Visibility);
    let pass = Pass::forward(source, view, Channels::Full(coefficients), EarlyStop::WhenSaturated);
    let counts = SampleCounts::of(samples, environment);
    let random = ChaCha8Rng::seed_from_u64(seed);
    let light = |(x, y): (usize, usize), surface: &Surface| {
        // One random stream per pixel, so that its samples do not depend on the order of rendering.
        let mut random = random.clone();
        random.set_stream(pixels_before + (y * view.width + x) as u64);
        let point = surface_point(&pass, x, y);
        let reflector = reflector(surface, source.options);
        let sum =
            estimate(&reflector, environment, surface.blocked.map(f64::from), counts, &mut random, |d| {
                f64::from(occluders.transmittance(point, d.to_array().map(|v| v as f32)))
            });
        let bounced = reflector.diffuse();
        let finite = |v: f64| v.min(MAX_RADIANCE) as f32;
        OutgoingRadiance {
            diffuse: std::array::from_fn(|c| {
                finite(sum.diffuse[c]) + bounced[c] as f32 * surface.gathered[c]
            }),
            specular: sum.specular.map(finite),
        }
    };
    resolve(&pass, shader, job.outputs, job.depth_scale, light)
}
