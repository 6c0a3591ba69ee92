//! Options for encoding a frame.

use crate::render::FrameMetadata;
use crate::render::error::RenderError;
use relume_spec::rendering::{
    AlphaMode, Background, ColourDepth, FrameFormat, Output, Primaries, ToneCurve, is_colour,
};

/// Options for encoding a frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EncodeOptions {
    /// Background of the model. For [`Background::Environment`] the frame must already include it
    /// ([`Renderer::show_environment`](crate::render::Renderer::show_environment)).
    pub background: Background,
    /// Tone curve of colours other than albedo. EXR is scene-referred.
    pub tone_curve: ToneCurve,
    /// Sample type of the colours of an EXR; `None` for 32-bit floats.
    pub colour_depth: Option<ColourDepth>,
    /// Alpha mode of the colours of an EXR. PNG always has straight alpha.
    pub alpha: Option<AlphaMode>,
    /// Primaries of the colours of an EXR. Other formats are sRGB.
    pub primaries: Option<Primaries>,
    /// Metadata of an EXR.
    pub frame_metadata: FrameMetadata,
}

impl EncodeOptions {
    /// Refuses options that a file of `format` does not support.
    ///
    /// # Errors
    /// Names the field of this type.
    pub fn check(&self, outputs: &[Output], format: FrameFormat) -> Result<(), RenderError> {
        use FrameFormat::{Exr, Jpeg, Png};
        let refuse = |field, reason: &str| Err(RenderError::Refused { field, reason: reason.to_owned() });
        if format != Exr && outputs.iter().any(|output| output.is_exr_only()) {
            let reason = "position, motion, material_id and cryptomatte need EXR: PNG and JPEG cannot store their values";
            return refuse("outputs", reason);
        }
        match (self.background, format) {
            (Background::Colour(_), Exr) => {
                return refuse("background", "a colour is display-referred, but EXR is scene-referred");
            }
            (Background::Colour(_), _) if !outputs.iter().any(|o| is_colour(*o)) => {
                return refuse(
                    "background",
                    "a colour applies only to colours, and the output is not a colour",
                );
            }
            (Background::Environment, _) if !outputs.contains(&Output::Rgb) => {
                return refuse("background", "environment requires the output rgb");
            }
            _ => {}
        }
        match (self.tone_curve, format) {
            (ToneCurve::Neutral | ToneCurve::Agx, Exr) => {
                return refuse("tone_curve", "does not apply to EXR, which is scene-referred");
            }
            (curve, Png) if curve != ToneCurve::Srgb && !outputs.iter().any(|o| is_colour(*o)) => {
                return refuse("tone_curve", "applies only to colours, and the output is not a colour");
            }
            (ToneCurve::Linear, Jpeg) => {
                return refuse("tone_curve", "linear requires 16 bits, which JPEG does not support");
            }
            _ => {}
        }
        if let (Some(_), Png | Jpeg) = (self.colour_depth, format) {
            return refuse("colour_depth", "is allowed only for EXR");
        }
        match (self.alpha, self.primaries, format) {
            (Some(_), _, Png | Jpeg) => refuse("alpha", "is allowed only for EXR; PNG has straight alpha"),
            (_, Some(_), Png | Jpeg) => {
                refuse("primaries", "is allowed only for EXR; other formats are sRGB")
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unsupported_format_options_are_refused_by_field() {
        let colour = EncodeOptions { background: Background::Colour([9; 3]), ..EncodeOptions::default() };
        let environment = EncodeOptions { background: Background::Environment, ..EncodeOptions::default() };
        let curve = |tone_curve| EncodeOptions { tone_curve, ..EncodeOptions::default() };
        let straight = EncodeOptions { alpha: Some(AlphaMode::Straight), ..EncodeOptions::default() };
        let acescg = EncodeOptions { primaries: Some(Primaries::Acescg), ..EncodeOptions::default() };
        let half = EncodeOptions { colour_depth: Some(ColourDepth::Half), ..EncodeOptions::default() };
        let refused = |options: &EncodeOptions, output, format| match options.check(&[output], format) {
            Err(RenderError::Refused { field, .. }) => Some(field),
            _ => None,
        };
        let (rgb, albedo, depth) = (Output::Rgb, Output::Albedo, Output::Depth);
        for (options, output, png, jpeg, exr) in [
            (&EncodeOptions::default(), albedo, None, None, None),
            (&colour, albedo, None, None, Some("background")),
            (&EncodeOptions::default(), depth, None, None, None),
            (&colour, depth, Some("background"), Some("background"), Some("background")),
            (&curve(ToneCurve::Linear), depth, Some("tone_curve"), Some("tone_curve"), None),
            (&environment, rgb, None, None, None),
            (&environment, albedo, Some("background"), Some("background"), Some("background")),
            (&curve(ToneCurve::Agx), rgb, None, None, Some("tone_curve")),
            (&curve(ToneCurve::Linear), rgb, None, Some("tone_curve"), None),
            (&half, rgb, Some("colour_depth"), Some("colour_depth"), None),
            (&straight, rgb, Some("alpha"), Some("alpha"), None),
            (&acescg, albedo, Some("primaries"), Some("primaries"), None),
        ] {
            let found =
                [FrameFormat::Png, FrameFormat::Jpeg, FrameFormat::Exr].map(|f| refused(options, output, f));
            assert_eq!(found, [png, jpeg, exr], "{options:?} {output:?}");
        }
    }
}
