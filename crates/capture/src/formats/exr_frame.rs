//! Rendered frames as multi-part OpenEXR: colours in one part, measurements in another.
//!
//! Colour parts name their colour space in the string attribute `colorInteropID`. Chromaticities are written unless
//! they are those of Rec.709, which a reader assumes by default. Measurements are in a part tagged `data`, so that no
//! tool applies colour management to a normal (ASWF Color Interop Forum, July 2026). The depth `Z` of pixels without a
//! surface is 0: infinity becomes NaN in the filters of compositors.

use std::io::Cursor;

use exr::block::{BlockIndex, UncompressedBlock, writer::ChunksWriter};
use exr::meta::{BlockDescription, attribute::Chromaticities, header::Header};
use exr::prelude::{
    AttributeValue, ChannelDescription, Compression, ImageAttributes, IntegerBounds, LayerAttributes,
    LineOrder, SampleType, Text, Vec2, f16,
};

use relume_spec::rendering::ColourDepth;

use crate::formats::{ImageFileError, exr_header};
use relume_spec::rendering::Primaries;

/// Interleaved values that become the channels `name.SUFFIX`, or bare suffixes if the name is empty.
#[derive(Debug, Clone, Copy)]
pub struct FrameLayer<'a> {
    /// E.g. `albedo`, `N`; empty for the main image (`R G B A`) and for depth (`Z`), whose values that are not finite are
    /// written as 0.
    pub name: &'a str,
    /// One letter per channel, e.g. `RGBA`, `XYZ`, `Y`.
    pub suffixes: &'a str,
    /// Row-major, `per_pixel` floats per pixel.
    pub values: &'a [f32],
    /// Index of the first channel among the floats of a pixel.
    pub first: usize,
    /// Floats per pixel, at least `first` plus the number of channels.
    pub per_pixel: usize,
}

impl<'a> FrameLayer<'a> {
    /// A layer with all of `values`, which have one float per pixel for each letter of `suffixes`.
    pub fn new(name: &'a str, suffixes: &'a str, values: &'a [f32]) -> Self {
        Self { name, suffixes, values, first: 0, per_pixel: suffixes.len() }
    }
}

/// A frame to write.
#[derive(Debug, Clone, Copy)]
pub struct FrameLayers<'a> {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Linear, scene-referred, in `primaries`: part `beauty`.
    pub colour: &'a [FrameLayer<'a>],
    /// Primaries of `colour`, written as its `colorInteropID`.
    pub primaries: Primaries,
    /// Measurements: part `data`, `colorInteropID = data`, always f32.
    pub data: &'a [FrameLayer<'a>],
    /// Attributes of every part.
    pub attributes: &'a FrameAttributes,
}

/// Attributes that every part of the file has.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameAttributes {
    /// Text attributes by name.
    pub texts: Vec<(&'static str, String)>,
    /// The camera.
    pub lens: Option<ExrLens>,
    /// Frames a second of the sequence that the frame belongs to: `framesPerSecond`.
    pub frames_per_second: Option<u32>,
}

/// A camera as standard OpenEXR attributes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExrLens {
    /// `worldToCamera`, which multiplies row vectors from the right.
    pub world_to_camera: [f32; 16],
    /// `screenWindowWidth`: width of the image on a screen at distance 1.
    pub window_width: f32,
    /// `screenWindowCenter`, y up.
    pub window_centre: [f32; 2],
    /// `pixelAspectRatio`: width of a pixel over its height.
    pub pixel_aspect: f32,
}

/// Largest half float.
pub(super) const HALF_MAX: f32 = 65_504.0;

/// The bytes of a ZIP-compressed multi-part file. A part without layers is left out. Besides the file, memory is
/// taken for a few lines at a time.
///
/// # Errors
/// [`ImageFileError::Encode`] names the layer that does not fill the frame, or says that the frame has no layers.
pub fn encode(frame: &FrameLayers<'_>, depth: ColourDepth) -> Result<Vec<u8>, ImageFileError> {
    encode_while(frame, depth, &|| true)
}

/// As [`encode`]; stops early once `is_wanted` returns false.
///
/// # Errors
/// As [`encode`], and if `is_wanted` returned false.
pub fn encode_while(
    frame: &FrameLayers<'_>,
    depth: ColourDepth,
    is_wanted: &dyn Fn() -> bool,
) -> Result<Vec<u8>, ImageFileError> {
    let parts = [
        ("beauty", frame.primaries.interop_id(), frame.colour, depth),
        ("data", "data", frame.data, ColourDepth::Full),
    ];
    let parts = parts.into_iter().filter(|p| !p.2.is_empty());
    let parts = parts.map(|(name, interop, content, depth)| part(frame, name, interop, content, depth));
    let parts: Vec<ExrPart<'_>> = parts.collect::<Result<_, _>>()?;
    if parts.is_empty() {
        return Err(ImageFileError::Encode("the frame has no layers".to_owned()));
    }
    let mut out = Cursor::new(Vec::new());
    let headers = parts.iter().map(|part| part.header.clone()).collect();
    let written = exr::block::write(&mut out, headers, true, |meta, writer| {
        let blocks = meta.collect_ordered_blocks(|index| parts[index.layer].block(index));
        writer.on_progress(|_| ()).compress_all_blocks_parallel(&meta, blocks.take_while(|_| is_wanted()))
    });
    if !is_wanted() {
        return Err(ImageFileError::Encode("encoding was cancelled".to_owned()));
    }
    written.map_err(|e| ImageFileError::Encode(e.to_string()))?;
    let mut file = out.into_inner();
    exr_header::sort_attributes(&mut file);
    Ok(file)
}

/// A part of the file with the source of its pixels.
struct ExrPart<'a> {
    header: Header,
    /// Sorted as the header's channels.
    channels: Vec<ExrChannel<'a>>,
}

/// One channel: every `step`th value of `values` from `first` on.
struct ExrChannel<'a> {
    name: Text,
    values: &'a [f32],
    first: usize,
    step: usize,
    depth: ColourDepth,
    /// True for distances from the camera, which are 0 where nothing is.
    is_distance: bool,
}

impl ExrChannel<'_> {
    fn description(&self) -> ChannelDescription {
        let sample = match self.depth {
            ColourDepth::Half => SampleType::F16,
            ColourDepth::Full => SampleType::F32,
        };
        ChannelDescription::named(self.name.clone(), sample)
    }
}

impl ExrPart<'_> {
    /// The lines of a block.
    fn block(&self, index: BlockIndex) -> UncompressedBlock {
        let width = self.header.layer_size.width();
        UncompressedBlock::from_lines(&self.header.channels, index, |line| {
            let ExrChannel { values, first, step, depth, is_distance, .. } =
                self.channels[line.location.channel];
            let start = line.location.position.y() * width + line.location.position.x();
            let value = |x: usize| {
                let value = values[first + (start + x) * step];
                if is_distance && !value.is_finite() { 0.0 } else { value }
            };
            // Writing to a line in memory cannot fail.
            let _ = match depth {
                ColourDepth::Half => {
                    line.write_samples(|x| f16::from_f32(value(x).clamp(-HALF_MAX, HALF_MAX)))
                }
                ColourDepth::Full => line.write_samples(value),
            };
        })
    }
}

fn size(frame: &FrameLayers<'_>) -> Vec2<usize> {
    Vec2(frame.width as usize, frame.height as usize)
}

fn part<'a>(
    frame: &FrameLayers<'a>,
    name: &str,
    interop: &str,
    content: &[FrameLayer<'a>],
    depth: ColourDepth,
) -> Result<ExrPart<'a>, ImageFileError> {
    let mut channels = Vec::new();
    for layer in content {
        let step = layer.per_pixel;
        let has_channels = !layer.suffixes.is_empty() && layer.first + layer.suffixes.len() <= step;
        if !has_channels || layer.values.len() != size(frame).area() * step || layer.values.is_empty() {
            let reason = format!("layer {:?} does not fill {}x{}", layer.name, frame.width, frame.height);
            return Err(ImageFileError::Encode(reason));
        }
        for (first, suffix) in (layer.first..).zip(layer.suffixes.chars()) {
            let name = text(&channel_name(layer.name, suffix))?;
            let is_distance = layer.name.is_empty() && suffix == 'Z';
            channels.push(ExrChannel { name, values: layer.values, first, step, depth, is_distance });
        }
    }
    // The channel order that the format requires.
    channels.sort_by(|a, b| a.name.cmp(&b.name));
    let descriptions = channels.iter().map(ExrChannel::description).collect();
    let header = Header::new(text(name)?, size(frame), descriptions)
        .with_encoding(Compression::ZIP16, BlockDescription::ScanLines, LineOrder::Increasing)
        .with_shared_attributes(shared_attributes(frame))
        .with_attributes(part_attributes(frame.attributes, name, interop)?);
    Ok(ExrPart { header, channels })
}

fn shared_attributes(frame: &FrameLayers<'_>) -> ImageAttributes {
    let mut shared = ImageAttributes::new(IntegerBounds::from_dimensions(size(frame)));
    shared.pixel_aspect = frame.attributes.lens.map_or(1.0, |lens| lens.pixel_aspect);
    if frame.primaries != Primaries::default() {
        let [red, green, blue, white] = frame.primaries.chromaticities().map(|[x, y]| Vec2(x, y));
        shared.chromaticities = Some(Chromaticities { red, green, blue, white });
    }
    shared
}

/// The attributes of the part `name` whose colour space is `interop`.
pub(super) fn part_attributes(
    of: &FrameAttributes,
    name: &str,
    interop: &str,
) -> Result<LayerAttributes, ImageFileError> {
    let mut attributes = LayerAttributes::named(text(name)?);
    attributes.other.insert(text("colorInteropID")?, AttributeValue::Text(text(interop)?));
    for (name, value) in &of.texts {
        attributes.other.insert(text(name)?, AttributeValue::Text(text(value)?));
    }
    if let Some(lens) = &of.lens {
        attributes.world_to_camera = Some(lens.world_to_camera);
        attributes.screen_window_width = lens.window_width;
        attributes.screen_window_center = Vec2(lens.window_centre[0], lens.window_centre[1]);
    }
    attributes.frames_per_second = of.frames_per_second.and_then(|fps| Some((i32::try_from(fps).ok()?, 1)));
    attributes.software_name = Some(text(concat!("relume ", env!("CARGO_PKG_VERSION")))?);
    Ok(attributes)
}

fn channel_name(layer: &str, suffix: char) -> String {
    if layer.is_empty() { suffix.to_string() } else { format!("{layer}.{suffix}") }
}

/// `s` as a text of a file.
pub(super) fn text(s: &str) -> Result<Text, ImageFileError> {
    Text::new_or_none(s).ok_or_else(|| ImageFileError::Encode(format!("{s:?} cannot be an EXR name")))
}

#[cfg(test)]
mod tests {
    use exr::prelude::{AnyChannels, FlatSamples, Image, ReadChannels, ReadLayers};

    use super::*;

    fn read(bytes: &[u8]) -> Image<exr::image::Layers<AnyChannels<FlatSamples>>> {
        let reader = exr::prelude::read().no_deep_data().largest_resolution_level();
        reader.all_channels().all_layers().all_attributes().from_buffered(Cursor::new(bytes)).unwrap()
    }

    fn example(depth: ColourDepth) -> Vec<u8> {
        example_in(depth, Primaries::Rec709)
    }

    fn example_in(depth: ColourDepth, primaries: Primaries) -> Vec<u8> {
        let rgba: Vec<f32> = (0..24).map(|i| i as f32 * 0.25).collect();
        let albedo = [0.5f32; 18];
        let z = [1.5, 2.5, f32::INFINITY, 0.1, 7.0, 1e6];
        let normal: Vec<f32> = (0..18).map(|i| i as f32 / 17.0 - 0.5).collect();
        let frame = FrameLayers {
            width: 3,
            height: 2,
            colour: &[FrameLayer::new("", "RGBA", &rgba), FrameLayer::new("albedo", "RGB", &albedo)],
            primaries,
            data: &[
                FrameLayer::new("", "Z", &z),
                FrameLayer::new("N", "XYZ", &normal),
                FrameLayer::new("roughness", "Y", &[0.25; 6]),
            ],
            attributes: &FrameAttributes {
                texts: vec![("relume:model", "m".to_owned())],
                lens: Some(ExrLens {
                    world_to_camera: std::array::from_fn(|i| i as f32),
                    window_width: 2.5,
                    window_centre: [0.25, -0.5],
                    pixel_aspect: 1.5,
                }),
                frames_per_second: Some(24),
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
            assert_eq!(layer.attributes.frames_per_second, Some((24, 1)));
        }
        assert!(image.attributes.chromaticities.is_none());
        assert_eq!(image.attributes.pixel_aspect, 1.5);
    }

    #[test]
    fn other_primaries_are_stored_as_tag_and_chromaticities() {
        let image = read(&example_in(ColourDepth::Half, Primaries::Acescg));
        let tag = |part: usize| {
            let key = Text::new_or_none("colorInteropID").unwrap();
            image.layer_data[part].attributes.other[&key].clone()
        };
        assert_eq!(tag(0), AttributeValue::Text(Text::new_or_none("lin_ap1_scene").unwrap()));
        assert_eq!(tag(1), AttributeValue::Text(Text::new_or_none("data").unwrap()));
        assert_eq!(image.attributes.chromaticities.unwrap().green, Vec2(0.165, 0.83));
    }

    #[test]
    fn equal_frames_give_equal_bytes() {
        // The order of a hash map would differ between two files.
        assert_eq!(example(ColourDepth::Half), example(ColourDepth::Half));
        assert_ne!(example(ColourDepth::Half), example(ColourDepth::Full), "the control");
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
            assert_eq!(values(1, 3), [1.5, 2.5, 0.0, 0.1, 7.0, 1e6], "depth stays f32, and nothing is 0");
        }
    }

    #[test]
    fn layers_of_wrong_length_are_refused_by_name() {
        let colour = [FrameLayer::new("albedo", "RGB", &[0.0; 5])];
        let frame = FrameLayers {
            width: 2,
            height: 1,
            colour: &colour,
            primaries: Primaries::Rec709,
            data: &[],
            attributes: &FrameAttributes::default(),
        };
        assert!(encode(&frame, ColourDepth::Half).unwrap_err().to_string().contains("albedo"));
        assert!(encode(&FrameLayers { colour: &[], ..frame }, ColourDepth::Half).is_err());
    }

    #[test]
    fn encoding_stops_when_cancelled() {
        let values = vec![0.5; 64 * 64];
        let colour = [FrameLayer::new("", "Y", &values)];
        let attributes = &FrameAttributes::default();
        let frame = FrameLayers {
            width: 64,
            height: 64,
            colour: &colour,
            primaries: Primaries::Rec709,
            data: &[],
            attributes,
        };
        let asked = std::cell::Cell::new(0);
        let twice = || {
            asked.set(asked.get() + 1);
            asked.get() <= 2
        };
        assert!(
            encode_while(&frame, ColourDepth::Full, &twice).unwrap_err().to_string().contains("cancelled")
        );
        assert_eq!(asked.get(), 4, "once per encoded block, at the third block and at the end");
        assert!(encode(&frame, ColourDepth::Full).is_ok(), "the control");
    }
}
