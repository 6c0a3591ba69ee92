//! The Monte-Carlo tier: each pixel's integral over the environment by Monte-Carlo, with a query through the Gaussians
//! towards every direction drawn. What is blocked sends the light that was gathered, as in the standard tier.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::render::Frame;
use crate::render::cpu_frame_job::CpuFrameJob;
use relume_engine::cpu::{OccluderBvh, Pass, Surface, reflector, resolve, surface_point};
use relume_layout::channel::{Channels, OutgoingRadiance};
use relume_layout::constants::EarlyStop;
use relume_scene::Field;
use relume_scene::light::{EnvSampler, SampleCounts, estimate};
use relume_spec::rendering::Quality;

/// Most rows of a sampled environment: a texel of 0.35 degrees, two thirds of the sun.
pub(super) const MAX_ROWS: usize = 512;
/// A frame is f32 and finite, whatever a single sample of an extreme light came to.
const MAX_RADIANCE: f64 = 1e36;

/// Renders every pixel with `quality.samples` directions; the bytes depend on `quality.seed` and on nothing else that is
/// random. `pixels_before` is the number of the frame's pixels above the job's.
pub(super) fn render(
    job: &CpuFrameJob<'_>,
    environment: &EnvSampler,
    occluders: &OccluderBvh,
    quality: Quality,
    pixels_before: u64,
) -> Frame {
    let view = job.frame.view;
    let coefficients = job.source.gaussians.width(Field::Visibility);
    let pass = Pass::forward(&job.source, view, Channels::Full(coefficients), EarlyStop::WhenSaturated);
    let shares = SampleCounts::of(quality.samples, environment);
    let random = ChaCha8Rng::seed_from_u64(quality.seed);
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
    resolve(&pass, &job.shader, job.frame.outputs, job.frame.depth_scale, light)
}
