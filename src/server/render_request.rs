//! Validates the fields of a render request. Errors name the field.

use crate::server::problem::Problem;
use relume_api::renders::RenderRequest;
use relume_scene::Camera;
use relume_spec::rendering::{FrameFormat, Lamp, MAX_LAMPS, Output, Quality, Tier, is_colour};
use relume_train::render::{EncodeOptions, Orbit, RenderError};

/// Maximum side of a frame, pixels.
const MAX_SIDE: u32 = 4096;
/// Side of a small picture when the request omits it, pixels.
const PICTURE_SIDE: u32 = 256;
/// Maximum number of queries through the Gaussians for a frame of the Monte-Carlo tier: on the CPU engine, where they take some
/// seconds, and on a GPU.
const MAX_QUERIES: [u64; 2] = [1 << 21, 1 << 27];

/// The requested tier and samples for a frame of `size`, width and height in pixels. Refuses a frame that would occupy a
/// rendering thread for too long.
pub(super) fn quality(
    tier: Tier,
    samples: Option<u32>,
    seed: Option<u64>,
    size: (u32, u32),
    on_gpu: bool,
) -> Result<Quality, Problem> {
    let quality = Quality { tier, samples: samples.unwrap_or(Quality::SAMPLES), seed: seed.unwrap_or(0) };
    let queries = MAX_QUERIES[usize::from(on_gpu)];
    let most = match tier {
        Tier::MonteCarlo => queries / (u64::from(size.0) * u64::from(size.1)).max(1),
        _ => u64::MAX,
    };
    let most = most.min(u64::from(Quality::MAX_SAMPLES));
    if !(1..=most).contains(&u64::from(quality.samples)) {
        let detail = match most {
            0 => format!("the tier monte_carlo renders images of at most {queries} pixels"),
            most => format!("must be 1 to {most} for this tier and size, got {}", quality.samples),
        };
        return Err(Problem::invalid_field("/samples", detail));
    }
    Ok(quality)
}

/// Greatest number of pixels times lamps in the tiers that trace shadows of lamps in each pixel.
const MAX_LAMP_PIXELS: u64 = 1 << 22;

/// Refuses outputs that the file format does not support.
pub(super) fn check_outputs(outputs: &[Output], format: FrameFormat) -> Result<(), Problem> {
    let refuse = |why: &str| Err(Problem::invalid_field("/outputs", why));
    if let Some(i) = (1..outputs.len()).find(|&i| outputs[..i].contains(&outputs[i])) {
        return Err(Problem::invalid_field(format!("/outputs/{i}"), "is listed twice"));
    }
    match (outputs, format) {
        ([], _) => refuse("must contain at least one output"),
        ([_], FrameFormat::Png) | (_, FrameFormat::Exr) => Ok(()),
        ([one], FrameFormat::Jpeg) if is_colour(*one) => Ok(()),
        ([_], FrameFormat::Jpeg) => {
            refuse("is not a colour and cannot be stored as JPEG; accept image/png or image/x-exr")
        }
        _ => refuse("only image/x-exr can hold several outputs"),
    }
}

/// Refuses outputs of single frames that only sequences have.
pub(super) fn check_single(outputs: &[Output]) -> Result<(), Problem> {
    match outputs.contains(&Output::Motion) {
        true => {
            let why = "motion needs a sequence; request an export of frames with a path or a turntable";
            Err(Problem::invalid_field("/outputs", why))
        }
        false => Ok(()),
    }
}

/// Refuses a height of the ground without outputs of the ground, or one that is not finite.
pub(super) fn check_ground(height: Option<f64>, outputs: &[Output]) -> Result<(), Problem> {
    let refuse = |why: &str| Err(Problem::invalid_field("/ground_height", why));
    match height {
        Some(height) if !height.is_finite() => refuse("must be finite"),
        Some(_) if !outputs.iter().any(|output| output.is_of_ground()) => refuse(
            "applies to the outputs shadow, shadow_key, shadow_fill, bounce, contact, lamp_light and lamp_shadow; add one of them to outputs",
        ),
        _ => Ok(()),
    }
}

/// Refuses lamps without outputs that show them, too many lamps for the tier and size, and the first invalid lamp.
pub(super) fn check_lamps(
    lamps: &[Lamp],
    outputs: &[Output],
    (tier, size): (Tier, (u32, u32)),
) -> Result<(), Problem> {
    if lamps.is_empty() {
        return Ok(());
    }
    if !outputs.iter().any(|output| output.shows_lamps()) {
        let detail = "applies to the outputs rgb, diffuse, specular, lamp_light and lamp_shadow; add one of them to outputs";
        return Err(Problem::invalid_field("/lamps", detail));
    }
    let most = MAX_LAMP_PIXELS / (u64::from(size.0) * u64::from(size.1)).max(1);
    let traces = matches!(tier, Tier::High | Tier::MonteCarlo)
        || outputs.iter().any(|output| output.is_of_lamps_on_ground());
    if traces && lamps.len() as u64 > most {
        let detail = format!(
            "pixels times lamps must be at most {MAX_LAMP_PIXELS} in the tiers high and monte_carlo and for lamps on the ground: \
             {most} lamps for this size, got {}",
            lamps.len()
        );
        return Err(Problem::invalid_field("/lamps", detail));
    }
    if lamps.len() > MAX_LAMPS {
        let detail = format!("must have at most {MAX_LAMPS} entries, got {}", lamps.len());
        return Err(Problem::invalid_field("/lamps", detail));
    }
    match lamps.iter().enumerate().find_map(|(i, lamp)| Some((i, lamp.fault()?))) {
        Some((i, (field, reason))) => Err(Problem::invalid_field(format!("/lamps/{i}/{field}"), reason)),
        None => Ok(()),
    }
}

/// The encoding options. Refuses options that the format does not support.
pub(super) fn finish(request: &RenderRequest, format: FrameFormat) -> Result<EncodeOptions, Problem> {
    let encoding = EncodeOptions {
        background: request.background,
        tone_curve: request.tone_curve,
        colour_depth: request.colour_depth,
        ..EncodeOptions::default()
    };
    check_finish(&encoding, &request.outputs, format).map(|()| encoding)
}

/// Refuses options that the format does not support.
pub(super) fn check_finish(
    encoding: &EncodeOptions,
    outputs: &[Output],
    format: FrameFormat,
) -> Result<(), Problem> {
    encoding.check(outputs, format).map_err(|error| match error {
        RenderError::Refused { field, reason } => Problem::invalid_field(format!("/{field}"), reason),
        other => Problem::internal(other),
    })
}

/// The camera of a small square picture around a model, from the parameters of the address. `size` pixels a side.
pub(super) fn orbit(
    azimuth_deg: Option<f64>,
    elevation_deg: Option<f64>,
    size: Option<u32>,
) -> Result<Orbit, Problem> {
    let orbit = Orbit { azimuth_deg, elevation_deg, size: size.unwrap_or(PICTURE_SIDE) };
    if !(16..=1024).contains(&orbit.size) {
        return Err(Problem::invalid_field("query/size", "must be 16 to 1024"));
    }
    if !orbit.azimuth_deg.is_none_or(f64::is_finite) {
        return Err(Problem::invalid_field("query/azimuth", "must be finite"));
    }
    if !orbit.elevation_deg.is_none_or(|degrees| (-90.0..=90.0).contains(&degrees)) {
        return Err(Problem::invalid_field("query/elevation", "must be -90 to 90"));
    }
    Ok(orbit)
}

/// The requested camera.
pub(super) fn camera(request: &RenderRequest) -> Result<Camera, Problem> {
    check_sides((request.width, request.height))?;
    request
        .camera
        .camera((request.width, request.height))
        .map_err(|error| Problem::invalid_field(format!("/camera{}", error.pointer), error.detail))
}

/// Refuses a width or height out of range.
pub(super) fn check_sides((width, height): (u32, u32)) -> Result<(), Problem> {
    for (field, side) in [("/width", width), ("/height", height)] {
        if !(1..=MAX_SIDE).contains(&side) {
            return Err(Problem::invalid_field(field, format!("must be 1 to {MAX_SIDE}, got {side}")));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sample_limit_depends_on_pixels_and_device() {
        let asked = |tier, samples, side, on_gpu| quality(tier, Some(samples), None, (side, side), on_gpu);
        let refused = |samples, side, on_gpu| asked(Tier::MonteCarlo, samples, side, on_gpu).is_err();
        assert!(refused(128, 800, false) && !refused(128, 800, true));
        assert!(refused(513, 64, false) && !refused(512, 64, false));
        assert!(refused(256, 800, true) && refused(0, 8, true));
        let why = asked(Tier::MonteCarlo, 1, 2048, false).unwrap_err();
        assert!(format!("{why:?}").contains("2097152 pixels"), "{why:?}");
        assert!(asked(Tier::High, 64, 4096, false).is_ok(), "the control: other tiers draw no samples");
    }
}
