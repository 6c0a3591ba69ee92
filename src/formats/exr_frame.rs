//! Rendered frames as multi-part OpenEXR: colours in one part, measurements in another.
//!
//! Colour parts name their colour space by the string attribute `colorInteropID` and carry no chromaticities;
//! measurements live in a part tagged `data`, so that no tool applies colour management to a normal (ASWF Color Interop
//! Forum, July 2026).

use std::io::Cursor;

use exr::prelude::{
    AnyChannel, AnyChannels, AttributeValue, Blocks, Compression, Encoding, FlatSamples, Image,
    ImageAttributes, IntegerBounds, Layer, LayerAttributes, LineOrder, Text, Vec2, WritableImage, f16,
};

use serde::{Deserialize, Serialize};

use crate::formats::ImageFileError;

/// Interleaved values that become channels `name.SUFFIX`, or bare suffixes when the name is empty.
#[derive(Debug, Clone, Copy)]
pub struct FrameLayer<'a> {
    /// E.g. `albedo`, `N`; empty for the main image (`R G B A`) and for depth (`Z`).
    pub name: &'a str,
    /// One letter per channel, e.g. `RGBA`, `XYZ`, `Y`.
    pub suffixes: &'a str,
    /// Row-major, `suffixes.len()` floats per pixel.
    pub values: &'a [f32],
}

/// A frame to be written.
#[derive(Debug, Clone, Copy)]
pub struct FrameLayers<'a> {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Linear Rec.709, scene-referred: part `beauty`, `colorInteropID = lin_rec709_scene`.
    pub colour: &'a [FrameLayer<'a>],
    /// Measurements: part `data`, `colorInteropID = data`, always f32.
    pub data: &'a [FrameLayer<'a>],
    /// How it was made.
    pub attributes: &'a FrameAttributes,
}

/// What every part of the file says beside its pixels.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameAttributes {
    /// Text attributes by name.
    pub texts: Vec<(&'static str, String)>,
    /// The camera.
    pub lens: Option<ExrLens>,
}

/// A camera, as the standard attributes of OpenEXR have it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExrLens {
    /// `worldToCamera`: row vectors are multiplied with it.
    pub world_to_camera: [f32; 16],
    /// `screenWindowWidth`: of the picture on a screen at distance 1.
    pub window_width: f32,
    /// `screenWindowCenter`, y up.
    pub window_centre: [f32; 2],
    /// `pixelAspectRatio`: width of a pixel over its height.
    pub pixel_aspect: f32,
}

/// How colour is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "server", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum ColourDepth {
    /// 16-bit floats; values beyond 65,504 are clamped to it.
    #[default]
    Half,
    /// 32-bit floats.
    #[serde(rename = "float")]
    Full,
}

const HALF_MAX: f32 = 65_504.0;

/// The bytes of a ZIP-compressed multi-part file; a part without layers is left out.
///
/// # Errors
/// [`ImageFileError::Encode`] names the layer that does not fill the frame, or says that there is nothing to
/// write.
pub fn encode(frame: &FrameLayers<'_>, depth: ColourDepth) -> Result<Vec<u8>, ImageFileError> {
    let parts = [
        ("beauty", "lin_rec709_scene", frame.colour, depth),
        ("data", "data", frame.data, ColourDepth::Full),
    ];
    let mut layers = Vec::new();
    for (name, interop, content, depth) in parts.into_iter().filter(|p| !p.2.is_empty()) {
        layers.push(part(frame, name, interop, content, depth)?);
    }
    if layers.is_empty() {
        return Err(ImageFileError::Encode("the frame has no layers".to_owned()));
    }
    let window = IntegerBounds::from_dimensions(size(frame));
    let mut shared = ImageAttributes::new(window);
    shared.pixel_aspect = frame.attributes.lens.map_or(1.0, |lens| lens.pixel_aspect);
    let image = Image::from_layers(shared, layers);
    let mut out = Cursor::new(Vec::new());
    image.write().to_buffered(&mut out).map_err(|e| ImageFileError::Encode(e.to_string()))?;
    Ok(out.into_inner())
}

fn size(frame: &FrameLayers<'_>) -> Vec2<usize> {
    Vec2(frame.width as usize, frame.height as usize)
}

fn part(
    frame: &FrameLayers<'_>,
    name: &str,
    interop: &str,
    content: &[FrameLayer<'_>],
    depth: ColourDepth,
) -> Result<Layer<AnyChannels<FlatSamples>>, ImageFileError> {
    let mut channels = Vec::new();
    for layer in content {
        let width = layer.suffixes.len();
        if width == 0 || layer.values.len() != size(frame).area() * width || layer.values.is_empty() {
            let reason = format!("layer {:?} does not fill {}x{}", layer.name, frame.width, frame.height);
            return Err(ImageFileError::Encode(reason));
        }
        for (k, suffix) in layer.suffixes.chars().enumerate() {
            let values = layer.values.iter().skip(k).step_by(width).copied();
            channels.push(AnyChannel::new(text(&channel_name(layer.name, suffix))?, samples(values, depth)));
        }
    }
    let mut attributes = LayerAttributes::named(text(name)?);
    attributes.other.insert(text("colorInteropID")?, AttributeValue::Text(text(interop)?));
    for (name, value) in &frame.attributes.texts {
        attributes.other.insert(text(name)?, AttributeValue::Text(text(value)?));
    }
    if let Some(lens) = &frame.attributes.lens {
        attributes.world_to_camera = Some(lens.world_to_camera);
        attributes.screen_window_width = lens.window_width;
        attributes.screen_window_center = Vec2(lens.window_centre[0], lens.window_centre[1]);
    }
    attributes.software_name = Some(text(concat!("relume ", env!("CARGO_PKG_VERSION")))?);
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    Ok(Layer::new(size(frame), attributes, encoding, AnyChannels::sort(channels.into())))
}

fn channel_name(layer: &str, suffix: char) -> String {
    if layer.is_empty() { suffix.to_string() } else { format!("{layer}.{suffix}") }
}

fn samples(values: impl Iterator<Item = f32>, depth: ColourDepth) -> FlatSamples {
    match depth {
        ColourDepth::Half => {
            FlatSamples::F16(values.map(|v| f16::from_f32(v.clamp(-HALF_MAX, HALF_MAX))).collect())
        }
        ColourDepth::Full => FlatSamples::F32(values.collect()),
    }
}

fn text(s: &str) -> Result<Text, ImageFileError> {
    Text::new_or_none(s).ok_or_else(|| ImageFileError::Encode(format!("{s:?} cannot be an EXR name")))
}

#[cfg(test)]
mod tests {
    use exr::prelude::{ReadChannels, ReadLayers};

    use super::*;

    fn read(bytes: &[u8]) -> Image<exr::image::Layers<AnyChannels<FlatSamples>>> {
        let reader = exr::prelude::read().no_deep_data().largest_resolution_level();
        reader.all_channels().all_layers().all_attributes().from_buffered(Cursor::new(bytes)).unwrap()
    }

    fn example(depth: ColourDepth) -> Vec<u8> {
        let rgba: Vec<f32> = (0..24).map(|i| i as f32 * 0.25).collect();
        let albedo = [0.5f32; 18];
        let z = [1.5, 2.5, f32::INFINITY, 0.1, 7.0, 1e6];
        let normal: Vec<f32> = (0..18).map(|i| i as f32 / 17.0 - 0.5).collect();
        let frame = FrameLayers {
            width: 3,
            height: 2,
            colour: &[
                FrameLayer { name: "", suffixes: "RGBA", values: &rgba },
                FrameLayer { name: "albedo", suffixes: "RGB", values: &albedo },
            ],
            data: &[
                FrameLayer { name: "", suffixes: "Z", values: &z },
                FrameLayer { name: "N", suffixes: "XYZ", values: &normal },
                FrameLayer { name: "roughness", suffixes: "Y", values: &[0.25; 6] },
            ],
            attributes: &FrameAttributes {
                texts: vec![("relume:model", "m".to_owned())],
                lens: Some(ExrLens {
                    world_to_camera: std::array::from_fn(|i| i as f32),
                    window_width: 2.5,
                    window_centre: [0.25, -0.5],
                    pixel_aspect: 1.5,
                }),
            },
        };
        encode(&frame, depth).unwrap()
    }

    #[test]
    fn parts_channels_and_colour_tags_read_back() {
        let image = read(&example(ColourDepth::Full));
        let names: Vec<String> = image
            .layer_data
            .iter()
            .flat_map(|l| l.channel_data.list.iter().map(|c| c.name.to_string()))
            .collect();
        let expected =
            ["A", "B", "G", "R", "albedo.B", "albedo.G", "albedo.R", "N.X", "N.Y", "N.Z", "Z", "roughness.Y"];
        assert_eq!(names, expected);
        for (layer, name, tag) in [(0, "beauty", "lin_rec709_scene"), (1, "data", "data")]
            .map(|(i, n, t)| (&image.layer_data[i], n, t))
        {
            assert_eq!(layer.attributes.layer_name.as_ref().unwrap().to_string(), name);
            let key = Text::new_or_none("colorInteropID").unwrap();
            assert_eq!(layer.attributes.other[&key], AttributeValue::Text(Text::new_or_none(tag).unwrap()));
            let model = &layer.attributes.other[&Text::new_or_none("relume:model").unwrap()];
            assert_eq!(*model, AttributeValue::Text(Text::new_or_none("m").unwrap()));
            assert_eq!(layer.attributes.world_to_camera, Some(std::array::from_fn(|i| i as f32)));
            assert_eq!(layer.attributes.screen_window_width, 2.5);
            assert_eq!(layer.attributes.screen_window_center, Vec2(0.25, -0.5));
            let software = layer.attributes.software_name.as_ref().unwrap().to_string();
            assert!(software.starts_with("relume "), "{software}");
        }
        assert!(image.attributes.chromaticities.is_none());
        assert_eq!(image.attributes.pixel_aspect, 1.5);
    }

    #[test]
    fn values_read_back_exactly_or_to_half_precision() {
        for (depth, tolerance) in [(ColourDepth::Full, 0.0), (ColourDepth::Half, 5e-4)] {
            let image = read(&example(depth));
            let values = |part: usize, channel: usize| -> Vec<f32> {
                image.layer_data[part].channel_data.list[channel].sample_data.values_as_f32().collect()
            };
            for (i, red) in values(0, 3).into_iter().enumerate() {
                assert!((red - i as f32).abs() <= tolerance * red.max(1.0), "{depth:?} {i} {red}");
            }
            assert_eq!(values(1, 3), [1.5, 2.5, f32::INFINITY, 0.1, 7.0, 1e6], "depth stays f32");
        }
    }

    #[test]
    fn layers_that_do_not_fill_the_frame_are_named() {
        let colour = [FrameLayer { name: "albedo", suffixes: "RGB", values: &[0.0; 5] }];
        let frame = FrameLayers {
            width: 2,
            height: 1,
            colour: &colour,
            data: &[],
            attributes: &FrameAttributes::default(),
        };
        assert!(encode(&frame, ColourDepth::Half).unwrap_err().to_string().contains("albedo"));
        assert!(encode(&FrameLayers { colour: &[], ..frame }, ColourDepth::Half).is_err());
    }
}
