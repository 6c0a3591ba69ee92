//! Frames with strong small lights. The shadow of each light is ray-traced in every pixel; tables represent the rest of the
//! environment.

use rayon::prelude::*;

use crate::cpu::pixel_light::{PixelShadows, UnshadowedLight};
use crate::cpu::{AttributeSource, OccluderBvh, Pass, SurfaceShader, blended_radiance, resolve};
use crate::{Frame, FrameJob};
use relume_layout::channel::{Channels, OutgoingRadiance};
use relume_layout::constants::EarlyStop;
use relume_scene::light::DominantLight;
use relume_scene::{Field, ShadeAt, VisibilityForm};

/// Renders every pixel under the rest of the environment and each light. The job's shader has the tables of both together.
pub(super) fn render(
    job: &FrameJob<'_>,
    (source, shader): (&AttributeSource<'_>, &SurfaceShader<'_>),
    lights: &[DominantLight],
    occluders: &OccluderBvh,
) -> Frame {
    let channels = Channels::Full(source.gaussians.width(Field::Visibility));
    let pass = Pass::forward(&source.under(*shader), job.view, channels, EarlyStop::WhenSaturated);
    let direct = direct(job, source, lights, &pass, occluders);
    resolve(&pass, shader, job.outputs, job.depth_scale, |(x, y), surface| {
        let mut sent = match shader.options.shade_at {
            ShadeAt::Gaussian => blended_radiance(&pass, (x, y)),
            ShadeAt::Pixel => shader.shade(surface).outgoing(),
        };
        sent.add(direct[y * job.view.width + x], 1.0);
        sent
    })
}

/// The radiance of the lights in each pixel, row-major.
fn direct(
    job: &FrameJob<'_>,
    source: &AttributeSource<'_>,
    lights: &[DominantLight],
    pass: &Pass,
    occluders: &OccluderBvh,
) -> Vec<OutgoingRadiance> {
    let view = job.view;
    let is_occluded = source.options.visibility != VisibilityForm::Off;
    let mut sum = vec![OutgoingRadiance::default(); view.width * view.height];
    for light in lights {
        let unhidden = UnshadowedLight::new(source, pass, light);
        let shadows = is_occluded.then(|| PixelShadows::new(pass, occluders, light));
        sum.par_iter_mut().enumerate().with_min_len(64).for_each(|(i, sum)| {
            let at = (i % view.width, i / view.width);
            let Some(sent) = unhidden.at(at) else { return };
            let share = shadows.as_ref().map_or(1.0, |shadows| shadows.share(at));
            sum.add(sent, share);
        });
    }
    sum
}
