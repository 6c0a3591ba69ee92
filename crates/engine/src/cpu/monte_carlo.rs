//! The Monte-Carlo tier: each pixel's integral over the environment by Monte-Carlo, with a query through the Gaussians
//! towards every direction drawn. What is blocked sends the light that was gathered, as in the standard tier.

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

/// A frame is f32 and finite, whatever a single sample of an extreme light came to.
const MAX_RADIANCE: f64 = 1e36;

/// The directions that a job draws.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sampling {
    /// Directions a pixel.
    pub samples: u32,
    /// Their seed.
    pub seed: u64,
    /// Pixels of the frame before the first one of the job: no two pixels have the same samples.
    pub pixels_before: u64,
}

/// Renders every pixel. The bytes depend on the seed and on nothing else that is random.
pub(super) fn render(
    job: &FrameJob<'_>,
    (source, shader): (&AttributeSource<'_>, &SurfaceShader<'_>),
    environment: &EnvSampler,
    Sampling { samples, seed, pixels_before }: Sampling,
    occluders: &OccluderBvh,
) -> Frame {
    let view = job.view;
    let coefficients = source.gaussians.width(Field::Visibility);
    let pass = Pass::forward(source, view, Channels::Full(coefficients), EarlyStop::WhenSaturated);
    let shares = SampleCounts::of(samples, environment);
    let random = ChaCha8Rng::seed_from_u64(seed);
    let light = |(x, y): (usize, usize), surface: &Surface| {
        // A stream a pixel: no pixel's samples depend on who rendered the one before.
        let mut random = random.clone();
        random.set_stream(pixels_before + (y * view.width + x) as u64);
        let point = surface_point(&pass, x, y);
        let sum = estimate(
            &reflector(surface),
            environment,
            surface.blocked.map(f64::from),
            shares,
            &mut random,
            |d| f64::from(occluders.transmittance(point, d.to_array().map(|v| v as f32))),
        );
        let bounced = (1.0 - surface.metal) * std::f32::consts::FRAC_1_PI;
        let finite = |v: f64| v.min(MAX_RADIANCE) as f32;
        OutgoingRadiance {
            diffuse: std::array::from_fn(|c| {
                finite(sum.diffuse[c]) + surface.albedo[c] * bounced * surface.gathered[c]
            }),
            specular: sum.specular.map(finite),
        }
    };
    resolve(&pass, shader, job.outputs, job.depth_scale, light)
}
