//! Encodes frames as image files.

use std::borrow::Cow;

use rayon::prelude::*;

use crate::render::{EncodeOptions, Frame, cryptomatte};
use relume_capture::formats::ImageFileError;
use relume_capture::formats::exr_frame::{self, FrameLayer, FrameLayers};
use relume_capture::formats::image_file::{encode_jpeg, encode_png, encode_png16};
use relume_capture::formats::png_colour::{PngColour, with_colour};
use relume_scene::srgb;
use relume_spec::rendering::{
    AlphaMode, Background, ColourDepth, FrameFormat, Output, Primaries, ToneCurve, is_colour,
};

const JPEG_QUALITY: u8 = 90;
/// Least number of pixels that one thread encodes for display.
const PIXELS_PER_TASK: usize = 1 << 12;

/// An encoded frame.
#[derive(Debug)]
pub struct EncodedFrame {
    /// The bytes of the file.
    pub bytes: Vec<u8>,
    /// For a depth PNG: the depths of levels 0 and 65,534, capture units; level 65,535 means no surface.
    pub depth_range: Option<[f32; 2]>,
}

/// Encodes a frame.
///
/// - Colours (`rgb`, `albedo`, `diffuse`, `specular`, `radiance`): tone curve (albedo: sRGB), 8 bit, straight alpha;
///   16 bit with [`ToneCurve::Linear`]. A background colour is blended in display values.
/// - `normal`: 16 bit, `(n + 1) / 2`. `metallic`, `roughness`, `visibility`, `alpha`, `contact`: 8-bit grey, linear.
/// - `shadow`, its parts, and `bounce`: 8 bit with the sRGB curve, so that a product of display values is nearly that of light.
/// - `depth`: 16-bit grey, linear between the nearest and farthest depth of the frame.
/// - A PNG states its colour space: `sRGB`, or `gAMA` 1 for linear light and for outputs that are not colours.
/// - EXR: linear. Colours in part `beauty` (`rgb` with alpha as `RGBA`), premultiplied unless
///   [`EncodeOptions::alpha`] specifies otherwise; all other outputs in part `data`. 32-bit floats. Some outputs need EXR
///   ([`Output::is_exr_only`]).
///
/// # Errors
/// If the frame lacks an output, or the encoder fails.
pub fn encode_frame(
    frame: &Frame,
    outputs: &[Output],
    format: FrameFormat,
    options: &EncodeOptions,
) -> Result<EncodedFrame, ImageFileError> {
    encode_wanted_frame(frame, outputs, format, options, &|| true)
}

/// As [`encode_frame`]. Encoding an EXR, the only slow format, stops early once `is_wanted` returns false.
///
/// # Errors
/// As [`encode_frame`], and if `is_wanted` returned false.
pub fn encode_wanted_frame(
    frame: &Frame,
    outputs: &[Output],
    format: FrameFormat,
    options: &EncodeOptions,
    is_wanted: &dyn Fn() -> bool,
) -> Result<EncodedFrame, ImageFileError> {
    let bare = |bytes| EncodedFrame { bytes, depth_range: None };
    let first = outputs.first().copied().unwrap_or(Output::Rgb);
    match format {
        FrameFormat::Exr => exr(frame, outputs, options, is_wanted).map(bare),
        FrameFormat::Png => png(frame, first, options),
        FrameFormat::Jpeg => {
            let pixels = over_white(&colour::<u8>(frame, first, options)?);
            encode_jpeg(frame.width, frame.height, &pixels, JPEG_QUALITY).map(bare)
        }
    }
}

fn png(frame: &Frame, output: Output, options: &EncodeOptions) -> Result<EncodedFrame, ImageFileError> {
    let (w, h) = (frame.width, frame.height);
    let bare = |bytes| EncodedFrame { bytes, depth_range: None };
    let linear = |png: Vec<u8>| with_colour(&png, PngColour::Linear);
    if is_colour(output) {
        return match options.tone_curve {
            ToneCurve::Linear => {
                linear(encode_png16(w, h, &colour::<u16>(frame, output, options)?)?).map(bare)
            }
            _ => {
                let png = encode_png(w, h, &colour::<u8>(frame, output, options)?)?;
                with_colour(&png, PngColour::Srgb).map(bare)
            }
        };
    }
    let values = plane(frame, output)?;
    if output == Output::Depth {
        let (levels, range) = depth_levels(values);
        let bytes = linear(encode_png16(w, h, &levels)?)?;
        return Ok(EncodedFrame { bytes, depth_range: Some(range) });
    }
    if output.is_of_ground() && output.channels() == 3 {
        let pixels: Vec<[u8; 3]> = values.as_chunks::<3>().0.iter().map(|p| p.map(srgb::encode_u8)).collect();
        return with_colour(&encode_png(w, h, &pixels)?, PngColour::Srgb).map(bare);
    }
    if output.channels() == 3 {
        let level = |v: f32| ((v * 0.5 + 0.5).clamp(0.0, 1.0) * 65535.0).round() as u16;
        let pixels: Vec<[u16; 3]> = values.as_chunks::<3>().0.iter().map(|p| p.map(level)).collect();
        return linear(encode_png16(w, h, &pixels)?).map(bare);
    }
    let level = |v: &f32| [(v.clamp(0.0, 1.0) * 255.0).round() as u8];
    linear(encode_png(w, h, &values.iter().map(level).collect::<Vec<_>>())?).map(bare)
}

fn plane(frame: &Frame, output: Output) -> Result<&[f32], ImageFileError> {
    let plane = frame.planes.get(&output).map(Vec::as_slice);
    plane.ok_or_else(|| ImageFileError::Encode(format!("the frame lacks {output:?}")))
}

/// The integer type of a channel.
trait ChannelLevel: Copy + Send {
    /// The level nearest to a value in [0, 1].
    fn nearest(value: f32) -> Self;

    /// The levels of a colour with tone curve `curve`.
    fn shown(colour: [f32; 3], curve: ToneCurve) -> [Self; 3] {
        curve.apply(colour).map(Self::nearest)
    }
}

impl ChannelLevel for u8 {
    fn nearest(value: f32) -> Self {
        srgb::to_u8(value)
    }

    fn shown(colour: [f32; 3], curve: ToneCurve) -> [Self; 3] {
        match curve {
            ToneCurve::Linear => curve.apply(colour).map(Self::nearest),
            curve => curve.light(colour).map(srgb::encode_u8),
        }
    }
}

impl ChannelLevel for u16 {
    fn nearest(value: f32) -> Self {
        (value * 65535.0 + 0.5) as u16
    }
}

/// A colour output as display-referred RGBA, straight alpha.
fn colour<L: ChannelLevel>(
    frame: &Frame,
    output: Output,
    options: &EncodeOptions,
) -> Result<Vec<[L; 4]>, ImageFileError> {
    let alpha = plane(frame, Output::Alpha)?;
    let pixels = plane(frame, output)?.as_chunks::<3>().0;
    // Albedo is the only colour that is not premultiplied, and the only one that never exceeds 1.
    let curve = match (output, options.tone_curve) {
        (Output::Albedo, ToneCurve::Neutral | ToneCurve::Agx) => ToneCurve::Srgb,
        (_, curve) => curve,
    };
    let pixel = |(&rgb, &alpha): (&[f32; 3], &f32)| {
        let alpha = coverage(alpha, output, options);
        let divisor = if output == Output::Albedo { 1.0 } else { alpha.max(1e-6) };
        let colour = rgb.map(|v| v / divisor);
        let ([r, g, b], alpha) = match options.background {
            Background::Colour(behind) => {
                let shown = over(curve.apply(colour), alpha, shown_as(behind, curve));
                (shown.map(L::nearest), 1.0)
            }
            _ => (L::shown(colour, curve), alpha),
        };
        [r, g, b, L::nearest(alpha)]
    };
    Ok(pixels.par_iter().zip(alpha).with_min_len(PIXELS_PER_TASK).map(pixel).collect())
}

/// Coverage of a pixel for `output`.
fn coverage(alpha: f32, output: Output, options: &EncodeOptions) -> f32 {
    match (output, options.background) {
        (Output::Rgb, Background::Environment) => 1.0,
        _ => alpha.clamp(0.0, 1.0),
    }
}

/// Composites one colour over another in display values, as browsers do.
fn over(shown: [f32; 3], alpha: f32, behind: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|k| shown[k] * alpha + behind[k] * (1.0 - alpha))
}

/// A display colour in the values of `curve`.
fn shown_as(colour: [u8; 3], curve: ToneCurve) -> [f32; 3] {
    let display = colour.map(|v| f32::from(v) / 255.0);
    if curve == ToneCurve::Linear { display.map(srgb::decode) } else { display }
}

/// Encodes an EXR with colours and measurements in separate parts.
fn exr(
    frame: &Frame,
    outputs: &[Output],
    options: &EncodeOptions,
    is_wanted: &dyn Fn() -> bool,
) -> Result<Vec<u8>, ImageFileError> {
    let alpha = plane(frame, Output::Alpha)?;
    let covered: Vec<f32> = alpha.iter().map(|a| coverage(*a, Output::Rgb, options)).collect();
    let mut colours = Vec::new();
    for output in outputs.iter().filter(|output| is_colour(**output)) {
        colours.push((*output, scene_referred(plane(frame, *output)?, alpha, *output, options)));
    }
    let mut colour: Vec<_> = colours.iter().flat_map(|(output, values)| layers(*output, values)).collect();
    if outputs.contains(&Output::Rgb) {
        colour.push(FrameLayer::new("", "A", &covered));
    }
    let mut data = Vec::new();
    for output in outputs.iter().filter(|output| !is_colour(**output)) {
        data.extend(layers(*output, plane(frame, *output)?));
    }
    let (width, height) = (frame.width, frame.height);
    let mut attributes =
        options.frame_metadata.attributes(options.background, options.alpha.unwrap_or_default());
    if outputs.contains(&Output::Cryptomatte) {
        attributes.texts.extend(cryptomatte::attributes(plane(frame, Output::Cryptomatte)?));
    }
    let primaries = options.primaries.unwrap_or_default();
    let layers =
        FrameLayers { width, height, colour: &colour, primaries, data: &data, attributes: &attributes };
    exr_frame::encode_while(&layers, options.colour_depth.unwrap_or(ColourDepth::Full), is_wanted)
}

/// The layers of an output, with the names that compositing tools expect.
fn layers(output: Output, values: &[f32]) -> impl Iterator<Item = FrameLayer<'_>> {
    let per_pixel = output.channels();
    let mut first = 0;
    layer_names(output).iter().map(move |(name, suffixes)| {
        let layer = FrameLayer { name, suffixes, values, first, per_pixel };
        first += suffixes.len();
        layer
    })
}

/// Names and channel suffixes of the layers of an output.
fn layer_names(output: Output) -> &'static [(&'static str, &'static str)] {
    match output {
        Output::Rgb => &[("", "RGB")],
        Output::Albedo => &[("albedo", "RGB")],
        Output::Diffuse => &[("diffuse", "RGB")],
        Output::Specular => &[("specular", "RGB")],
        Output::Radiance => &[("radiance", "RGB")],
        Output::Normal => &[("N", "XYZ")],
        Output::Depth => &[("", "Z")],
        Output::Position => &[("P", "XYZ")],
        Output::Shadow => &[("shadow", "RGB")],
        Output::ShadowKey => &[("shadow_key", "RGB")],
        Output::ShadowFill => &[("shadow_fill", "RGB")],
        Output::LampLight => &[("lamp_light", "RGB")],
        Output::LampShadow => &[("lamp_shadow", "RGB")],
        Output::Bounce => &[("bounce", "RGB")],
        Output::Contact => &[("contact", "Y")],
        Output::Confidence => &[("confidence", "Y")],
        Output::Metallic => &[("metallic", "Y")],
        Output::Roughness => &[("roughness", "Y")],
        Output::Visibility => &[("visibility", "Y")],
        Output::Alpha => &[("alpha", "Y")],
        Output::Motion => &[("forward", "uv"), ("backward", "uv")],
        Output::MaterialId => &[("material_id", "Y")],
        Output::Cryptomatte => {
            &[("CryptoMaterial00", "RGBA"), ("CryptoMaterial01", "RGBA"), ("CryptoMaterial02", "RGBA")]
        }
    }
}

/// A colour output in the primaries and alpha mode of `options`.
fn scene_referred<'a>(
    rgb: &'a [f32],
    alpha: &[f32],
    output: Output,
    options: &EncodeOptions,
) -> Cow<'a, [f32]> {
    let (mode, primaries) = (options.alpha.unwrap_or_default(), options.primaries.unwrap_or_default());
    let as_rendered = (AlphaMode::Premultiplied, Primaries::Rec709) == (mode, primaries);
    if as_rendered {
        return Cow::Borrowed(rgb);
    }
    let mut values = Vec::with_capacity(rgb.len());
    for (&colour, &alpha) in rgb.as_chunks::<3>().0.iter().zip(alpha) {
        let alpha = coverage(alpha, output, options);
        // Albedo is rendered without premultiplication.
        let colour = if output == Output::Albedo { colour } else { mode.of_premultiplied(colour, alpha) };
        values.extend(primaries.from_rec709(colour));
    }
    Cow::Owned(values)
}

fn over_white(pixels: &[[u8; 4]]) -> Vec<[u8; 3]> {
    let blend = |c: u8, a: u8| ((u32::from(c) * u32::from(a) + 255 * (255 - u32::from(a)) + 127) / 255) as u8;
    let pixels = pixels.par_iter().with_min_len(PIXELS_PER_TASK);
    pixels.map(|&[r, g, b, a]| [blend(r, a), blend(g, a), blend(b, a)]).collect()
}

/// Finite depths mapped linearly to 0 to 65,534; 65,535 without a surface.
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
    fn half_covered_pixel_keeps_its_albedo() {
        let planes = [(Output::Albedo, vec![0.5; 3]), (Output::Alpha, vec![0.5])].into();
        let frame = Frame { width: 1, height: 1, planes };
        let options = EncodeOptions { tone_curve: ToneCurve::Agx, ..EncodeOptions::default() };
        assert_eq!(colour::<u8>(&frame, Output::Albedo, &options).unwrap(), [[188, 188, 188, 128]]);
        assert_eq!(over_white(&[[188, 188, 188, 128]]), [[221; 3]]);
    }

    #[test]
    fn a_png_states_whether_it_is_linear() {
        let outputs = [
            Output::Rgb,
            Output::Albedo,
            Output::Normal,
            Output::Depth,
            Output::Roughness,
            Output::Visibility,
        ];
        let mut planes: std::collections::BTreeMap<_, _> =
            outputs.into_iter().map(|output| (output, vec![0.5; output.channels()])).collect();
        planes.insert(Output::Alpha, vec![1.0]);
        let frame = Frame { width: 1, height: 1, planes };
        let states = |output, tone_curve, format| {
            let options = EncodeOptions { tone_curve, ..EncodeOptions::default() };
            let bytes = encode_frame(&frame, &[output], format, &options).unwrap().bytes;
            let chunk = |name: &[u8]| bytes.windows(4).any(|window| window == name);
            (chunk(b"sRGB"), chunk(b"gAMA"))
        };
        for output in outputs {
            let is_display = is_colour(output);
            let wanted = (is_display, !is_display);
            assert_eq!(states(output, ToneCurve::Srgb, FrameFormat::Png), wanted, "{output:?}");
        }
        assert_eq!(states(Output::Rgb, ToneCurve::Linear, FrameFormat::Png), (false, true));
        assert_eq!(states(Output::Rgb, ToneCurve::Agx, FrameFormat::Png), (true, false));
        assert_eq!(states(Output::Rgb, ToneCurve::Srgb, FrameFormat::Jpeg), (false, false), "the control");
    }

    #[test]
    fn exr_contains_the_requested_outputs_and_infinite_depth() {
        let outputs = [Output::Rgb, Output::Normal, Output::Depth, Output::Visibility, Output::Alpha];
        let planes = outputs.map(|o| (o, vec![f32::INFINITY; o.channels()])).into();
        let mut frame = Frame { width: 1, height: 1, planes };
        frame.planes.insert(Output::Rgb, vec![0.25, 0.5, 2.0]);
        frame.planes.insert(Output::Alpha, vec![1.0]);
        let bytes =
            encode_frame(&frame, &outputs, FrameFormat::Exr, &EncodeOptions::default()).unwrap().bytes;
        let (_, _, pixels) = relume_capture::formats::exr_image::decode_rgba(&bytes).unwrap();
        assert_eq!(pixels, [[0.25, 0.5, 2.0, 1.0]], "linear and unclamped");
        let names = ["N.X", "Z", "visibility.Y", "alpha.Y"];
        let text = String::from_utf8_lossy(&bytes);
        assert!(names.iter().all(|name| text.contains(name)) && !text.contains("albedo"));
        assert!(
            encode_frame(&frame, &[Output::Albedo], FrameFormat::Exr, &EncodeOptions::default()).is_err(),
            "a missing output is an error"
        );
    }

    #[test]
    fn exr_has_the_requested_alpha_mode_and_primaries() {
        let planes =
            [(Output::Rgb, vec![0.25, 0.0, 0.0, 0.5, 0.5, 0.5]), (Output::Alpha, vec![0.5, 0.0])].into();
        let frame = Frame { width: 2, height: 1, planes };
        let file = |alpha, primaries| {
            let options = EncodeOptions { alpha, primaries, ..EncodeOptions::default() };
            encode_frame(&frame, &[Output::Rgb], FrameFormat::Exr, &options).unwrap().bytes
        };
        let pixels = |alpha, primaries| {
            relume_capture::formats::exr_image::decode_rgba(&file(alpha, primaries)).unwrap().2
        };
        let premultiplied = pixels(None, None);
        assert_eq!(premultiplied, [[0.25, 0.0, 0.0, 0.5], [0.5, 0.5, 0.5, 0.0]]);
        assert_eq!(pixels(Some(AlphaMode::Premultiplied), Some(Primaries::Rec709)), premultiplied);
        let straight = pixels(Some(AlphaMode::Straight), None);
        assert_eq!(straight, [[0.5, 0.0, 0.0, 0.5], [0.0; 4]]);
        // The decoder converts to Rec. 709 by the primaries that the file states.
        let read = pixels(Some(AlphaMode::Straight), Some(Primaries::Acescg))[0];
        let errors = [0, 1, 2, 3].map(|channel| (read[channel] - [0.5, 0.0, 0.0, 0.5][channel]).abs());
        assert!(errors.iter().all(|error| *error < 1e-3), "{read:?}");
        let states = |primaries, name: &[u8]| {
            let bytes = file(None, primaries);
            bytes.windows(name.len()).any(|window| window == name)
        };
        assert!(states(Some(Primaries::Acescg), b"lin_ap1_scene"), "the values are those of ACEScg");
        assert!(!states(None, b"lin_ap1_scene"), "the control");
    }

    #[test]
    fn background_replaces_alpha_and_keeps_the_alpha_output() {
        let planes = [(Output::Rgb, vec![0.25; 3]), (Output::Alpha, vec![0.5])].into();
        let frame = Frame { width: 1, height: 1, planes };
        let with =
            |background, tone_curve| EncodeOptions { background, tone_curve, ..EncodeOptions::default() };
        let shown =
            |background| colour::<u8>(&frame, Output::Rgb, &with(background, ToneCurve::Srgb)).unwrap()[0];
        assert_eq!(shown(Background::Transparent), [188, 188, 188, 128]);
        assert_eq!(shown(Background::Colour([0, 100, 255])), [94, 144, 221, 255]);
        // The frame already includes the environment.
        assert_eq!(shown(Background::Environment), [137, 137, 137, 255]);
        let linear = with(Background::Colour([128; 3]), ToneCurve::Linear);
        let half_of_both = (0.5 * 0.5 + 0.5 * srgb::decode(128.0 / 255.0)) * 65535.0;
        let pixel = colour::<u16>(&frame, Output::Rgb, &linear).unwrap()[0];
        assert!((f32::from(pixel[0]) - half_of_both).abs() < 1.0, "{pixel:?}");
        let linear = with(Background::Environment, ToneCurve::Linear);
        assert_eq!(colour::<u16>(&frame, Output::Rgb, &linear).unwrap(), [[16384, 16384, 16384, 65535]]);
        let bytes =
            encode_frame(&frame, &[Output::Rgb, Output::Alpha], FrameFormat::Exr, &linear).unwrap().bytes;
        assert_eq!(
            relume_capture::formats::exr_image::decode_rgba(&bytes).unwrap().2,
            [[0.25, 0.25, 0.25, 1.0]]
        );
    }

    #[test]
    fn depth_levels_keep_the_range_and_reserve_one_for_infinity() {
        let (levels, range) = depth_levels(&[2.0, f32::INFINITY, 4.0, 3.0]);
        assert_eq!(range, [2.0, 4.0]);
        assert_eq!(levels, [[0], [65535], [65534], [32767]]);
    }
}
