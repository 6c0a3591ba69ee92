//! Frames as image files.

use serde::{Deserialize, Serialize};

use crate::formats::ImageFileError;
use crate::formats::exr_frame::{self, ColourDepth, FrameLayer, FrameLayers};
use crate::formats::image_file::{encode_jpeg, encode_png, encode_png16};
use crate::render::{Frame, Output};

const JPEG_QUALITY: u8 = 90;

/// A kind of image file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum FrameFormat {
    /// One output, display-referred or mapped to integers.
    Png,
    /// One output over white.
    Jpeg,
    /// Every output, linear, 32-bit float.
    Exr,
}

impl FrameFormat {
    /// Every kind.
    pub const ALL: [Self; 3] = [Self::Png, Self::Jpeg, Self::Exr];

    /// Media type.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::Jpeg => "image/jpeg",
            Self::Exr => "image/x-exr",
        }
    }
}

/// An encoded frame.
#[derive(Debug)]
pub struct EncodedFrame {
    /// The file.
    pub bytes: Vec<u8>,
    /// For a depth PNG: the depths of levels 0 and 65,534, capture units; 65,535 is "nothing there".
    pub depth_range: Option<[f32; 2]>,
}

/// Encodes a frame.
///
/// - Colours (`rgb`, `albedo`, `diffuse`, `specular`, `radiance`): clamped, sRGB curve, 8 bit, straight alpha.
/// - `normal`: 16 bit, `(n + 1) / 2`. `metallic`, `roughness`, `visibility`, `alpha`: 8-bit grey, linear.
/// - `depth`: 16-bit grey, linear between the nearest and farthest depth of the frame.
/// - EXR: linear 32-bit floats, colours premultiplied as rendered in part `beauty` (`rgb` with alpha as `RGBA`),
///   everything else in part `data`.
///
/// # Errors
/// When the frame lacks an output, or the encoder fails.
pub fn encode_frame(
    frame: &Frame,
    outputs: &[Output],
    format: FrameFormat,
) -> Result<EncodedFrame, ImageFileError> {
    let bare = |bytes| EncodedFrame { bytes, depth_range: None };
    match format {
        FrameFormat::Exr => exr(frame, outputs).map(bare),
        FrameFormat::Png => png(frame, outputs.first().copied().unwrap_or(Output::Rgb)),
        FrameFormat::Jpeg => {
            let pixels = over_white(&colour(frame, outputs.first().copied().unwrap_or(Output::Rgb))?);
            encode_jpeg(frame.width, frame.height, &pixels, JPEG_QUALITY).map(bare)
        }
    }
}

/// True when the output is a colour, which JPEG can hold.
pub fn is_colour(output: Output) -> bool {
    use Output::{Albedo, Diffuse, Radiance, Rgb, Specular};
    matches!(output, Rgb | Albedo | Diffuse | Specular | Radiance)
}

fn png(frame: &Frame, output: Output) -> Result<EncodedFrame, ImageFileError> {
    let (w, h) = (frame.width, frame.height);
    let bare = |bytes| EncodedFrame { bytes, depth_range: None };
    if is_colour(output) {
        return encode_png(w, h, &colour(frame, output)?).map(bare);
    }
    let values = plane(frame, output)?;
    if output == Output::Depth {
        let (levels, range) = depth_levels(values);
        let bytes = encode_png16(w, h, &levels)?;
        return Ok(EncodedFrame { bytes, depth_range: Some(range) });
    }
    if output.channels() == 3 {
        let level = |v: f32| ((v * 0.5 + 0.5).clamp(0.0, 1.0) * 65535.0).round() as u16;
        let pixels: Vec<[u16; 3]> = values.as_chunks::<3>().0.iter().map(|p| p.map(level)).collect();
        return encode_png16(w, h, &pixels).map(bare);
    }
    let level = |v: &f32| [(v.clamp(0.0, 1.0) * 255.0).round() as u8];
    encode_png(w, h, &values.iter().map(level).collect::<Vec<_>>()).map(bare)
}

fn plane(frame: &Frame, output: Output) -> Result<&[f32], ImageFileError> {
    let plane = frame.planes.get(&output).map(Vec::as_slice);
    plane.ok_or_else(|| ImageFileError::Encode(format!("the frame lacks {output:?}")))
}

/// A colour output as display-referred RGBA: it takes the place of `rgb` in a frame of its own.
fn colour(frame: &Frame, output: Output) -> Result<Vec<[u8; 4]>, ImageFileError> {
    let alpha = plane(frame, Output::Alpha)?.to_vec();
    let mut values = plane(frame, output)?.to_vec();
    if output == Output::Albedo {
        // The one colour that is not premultiplied.
        values.iter_mut().enumerate().for_each(|(i, v)| *v *= alpha[i / 3]);
    }
    let planes = [(Output::Rgb, values), (Output::Alpha, alpha)].into();
    Ok(Frame { width: frame.width, height: frame.height, planes }.to_srgb8())
}

/// Colours and measurements in parts of their own.
fn exr(frame: &Frame, outputs: &[Output]) -> Result<Vec<u8>, ImageFileError> {
    let alpha = plane(frame, Output::Alpha)?;
    let with_rgb = outputs.contains(&Output::Rgb);
    let rgba = if with_rgb { interleaved(plane(frame, Output::Rgb)?, alpha) } else { Vec::new() };
    let (mut colour, mut data) = (Vec::new(), Vec::new());
    if with_rgb {
        colour.push(FrameLayer { name: "", suffixes: "RGBA", values: &rgba });
    }
    for output in outputs.iter().filter(|o| **o != Output::Rgb) {
        let (name, suffixes) = layer_name(*output);
        let layer = FrameLayer { name, suffixes, values: plane(frame, *output)? };
        if is_colour(*output) { colour.push(layer) } else { data.push(layer) }
    }
    let layers = FrameLayers { width: frame.width, height: frame.height, colour: &colour, data: &data };
    exr_frame::encode(&layers, ColourDepth::Full)
}

/// The names compositing tools expect.
fn layer_name(output: Output) -> (&'static str, &'static str) {
    match output {
        Output::Rgb => ("", "RGB"),
        Output::Albedo => ("albedo", "RGB"),
        Output::Diffuse => ("diffuse", "RGB"),
        Output::Specular => ("specular", "RGB"),
        Output::Radiance => ("radiance", "RGB"),
        Output::Normal => ("N", "XYZ"),
        Output::Depth => ("", "Z"),
        Output::Metallic => ("metallic", "Y"),
        Output::Roughness => ("roughness", "Y"),
        Output::Visibility => ("visibility", "Y"),
        Output::Alpha => ("alpha", "Y"),
    }
}

fn interleaved(rgb: &[f32], alpha: &[f32]) -> Vec<f32> {
    rgb.as_chunks::<3>().0.iter().zip(alpha).flat_map(|(&[r, g, b], &a)| [r, g, b, a]).collect()
}

fn over_white(pixels: &[[u8; 4]]) -> Vec<[u8; 3]> {
    let blend = |c: u8, a: u8| ((u32::from(c) * u32::from(a) + 255 * (255 - u32::from(a)) + 127) / 255) as u8;
    pixels.iter().map(|&[r, g, b, a]| [blend(r, a), blend(g, a), blend(b, a)]).collect()
}

/// Finite depths spread over 0 to 65,534; 65,535 where nothing is.
fn depth_levels(values: &[f32]) -> (Vec<[u16; 1]>, [f32; 2]) {
    let there = |v: &&f32| v.is_finite() && **v > 0.0;
    let near = values.iter().filter(there).copied().reduce(f32::min).unwrap_or(0.0);
    let far = values.iter().filter(there).copied().reduce(f32::max).unwrap_or(0.0);
    let span = (far - near).max(f32::MIN_POSITIVE);
    let level = |v: &f32| match there(&v) {
        true => [((v - near) / span * 65534.0).round() as u16],
        false => [u16::MAX],
    };
    (values.iter().map(level).collect(), [near, far])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_half_covered_pixel_keeps_its_albedo() {
        let planes = [(Output::Albedo, vec![0.5; 3]), (Output::Alpha, vec![0.5])].into();
        let frame = Frame { width: 1, height: 1, planes };
        assert_eq!(colour(&frame, Output::Albedo).unwrap(), [[188, 188, 188, 128]]);
        assert_eq!(over_white(&[[188, 188, 188, 128]]), [[221; 3]]);
    }

    #[test]
    fn an_exr_holds_every_output_asked_for_and_depth_may_be_infinite() {
        let outputs = [Output::Rgb, Output::Normal, Output::Depth, Output::Visibility, Output::Alpha];
        let planes = outputs.map(|o| (o, vec![f32::INFINITY; o.channels()])).into();
        let mut frame = Frame { width: 1, height: 1, planes };
        frame.planes.insert(Output::Rgb, vec![0.25, 0.5, 2.0]);
        frame.planes.insert(Output::Alpha, vec![1.0]);
        let bytes = encode_frame(&frame, &outputs, FrameFormat::Exr).unwrap().bytes;
        let (_, _, pixels) = crate::formats::exr_image::decode_rgba(&bytes).unwrap();
        assert_eq!(pixels, [[0.25, 0.5, 2.0, 1.0]], "linear and unclamped");
        let names = ["N.X", "Z", "visibility.Y", "alpha.Y"];
        let text = String::from_utf8_lossy(&bytes);
        assert!(names.iter().all(|name| text.contains(name)) && !text.contains("albedo"));
        assert!(
            encode_frame(&frame, &[Output::Albedo], FrameFormat::Exr).is_err(),
            "what is not there is not made up"
        );
    }

    #[test]
    fn depth_keeps_its_range_and_marks_nothing() {
        let (levels, range) = depth_levels(&[2.0, f32::INFINITY, 4.0, 3.0]);
        assert_eq!(range, [2.0, 4.0]);
        assert_eq!(levels, [[0], [65535], [65534], [32767]]);
    }
}
