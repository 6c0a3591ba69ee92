use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, ImageAttributes, LineOrder,
};
use exr::prelude::{Layer as WrittenLayer, LayerAttributes, Vec2, f16};

use super::*;

/// A file to write: windows, attributes, and channels by name with their values.
struct Example<'a> {
    data: IntegerBounds,
    display: IntegerBounds,
    chromaticities: Option<Chromaticities>,
    environment: Option<EnvironmentMap>,
    channels: &'a [(&'a str, f32)],
}

impl Default for Example<'_> {
    fn default() -> Self {
        let window = IntegerBounds::new((0, 0), (4, 2));
        let channels = &[("R", 0.5), ("G", 0.25), ("B", 2.0)];
        Self { data: window, display: window, chromaticities: None, environment: None, channels }
    }
}

impl Example<'_> {
    fn bytes(&self) -> Vec<u8> {
        let channels = self.channels.iter().map(|(name, value)| {
            AnyChannel::new(*name, FlatSamples::F32(vec![*value; self.data.size.area()]))
        });
        let mut own = LayerAttributes::named("light");
        own.layer_position = self.data.position;
        own.environment_map = self.environment;
        let channels = AnyChannels::sort(channels.collect());
        let layer = WrittenLayer::new(self.data.size, own, Encoding::FAST_LOSSLESS, channels);
        let mut shared = ImageAttributes::new(self.display);
        shared.chromaticities = self.chromaticities;
        let mut out = Cursor::new(Vec::new());
        Image::empty(shared).with_layer(layer).write().to_buffered(&mut out).unwrap();
        out.into_inner()
    }
}

fn acescg() -> Chromaticities {
    Chromaticities {
        red: Vec2(0.713, 0.293),
        green: Vec2(0.165, 0.83),
        blue: Vec2(0.128, 0.044),
        white: Vec2(0.32168, 0.33767),
    }
}

#[test]
fn rgb_round_trips_exactly() {
    let pixels: Vec<[f32; 3]> = (0..6).map(|i| [i as f32 * 0.3, -0.5, 6e4]).collect();
    let (w, h, back) = decode_rgba(&encode_rgb(3, 2, &pixels).unwrap()).unwrap();
    assert_eq!((w, h), (3, 2));
    assert!(back.iter().zip(&pixels).all(|(a, b)| a[..3] == b[..] && a[3] == 1.0));
}

#[test]
fn truncated_files_are_reported_as_damaged() {
    let bytes = encode_rgb(8, 8, &[[0.5; 3]; 64]).unwrap();
    for cut in [4, 20, bytes.len() / 2, bytes.len() - 1] {
        assert!(matches!(decode_rgba(&bytes[..cut]), Err(ImageFileError::Damaged(_))), "cut at {cut}");
    }
}

#[test]
fn layers_and_alpha_are_read() {
    let channels = [("sky.R", 0.5), ("sky.G", 0.25), ("sky.B", 2.0), ("sky.A", 0.75), ("Z", 9.0)];
    let image = decode(&Example { channels: &channels, ..Example::default() }.bytes()).unwrap();
    assert_eq!(image.pixels, [[0.5, 0.25, 2.0, 0.75]; 8]);
    let grey = decode(&Example { channels: &[("Y", 0.5), ("Z", 9.0)], ..Example::default() }.bytes());
    assert_eq!(grey.unwrap().pixels, [[0.5, 0.5, 0.5, 1.0]; 8]);
    let error = decode(&Example { channels: &[("Z", 9.0)], ..Example::default() }.bytes()).unwrap_err();
    assert!(error.to_string().contains("found: light.Z"), "{error}");
}

#[test]
fn stated_primaries_are_converted_to_rec709() {
    let channels = [("R", 0.613_097), ("G", 0.070_194), ("B", 0.020_616), ("A", 0.5)];
    let stated = Example { chromaticities: Some(acescg()), channels: &channels, ..Example::default() };
    let image = decode(&stated.bytes()).unwrap();
    let [r, g, b, a] = image.pixels[5];
    assert!((r - 1.0).abs() < 1e-4 && g.abs() < 1e-4 && b.abs() < 1e-4 && a == 0.5, "{:?}", image.pixels[5]);
    assert!(image.notes[0].contains("ACEScg"), "{:?}", image.notes);
    let absent = decode(&Example { chromaticities: None, ..stated }.bytes()).unwrap();
    assert_eq!((absent.pixels[5][0], absent.notes), (0.613_097, vec![]), "the control: nothing is stated");
}

#[test]
fn rec709_primaries_change_no_bit_and_zeros_are_noted() {
    let (red, green, blue, white) = (Vec2(0.64, 0.33), Vec2(0.3, 0.6), Vec2(0.15, 0.06), Vec2(0.3127, 0.329));
    let rec709 = Chromaticities { red, green, blue, white };
    let plain = decode(&Example::default().bytes()).unwrap();
    let stated = Example { chromaticities: Some(rec709), ..Example::default() };
    assert_eq!(decode(&stated.bytes()).unwrap(), plain);
    let zero = Vec2(0.0, 0.0);
    let zeros = Chromaticities { red: zero, green: zero, blue: zero, white: zero };
    let image = decode(&Example { chromaticities: Some(zeros), ..Example::default() }.bytes()).unwrap();
    assert_eq!(image.pixels, plain.pixels);
    assert!(image.notes[0].contains("unusable"), "{:?}", image.notes);
}

#[test]
fn data_windows_lie_in_their_display_window() {
    let cropped = Example {
        data: IntegerBounds::new((10, 21), (2, 1)),
        display: IntegerBounds::new((10, 20), (4, 2)),
        ..Example::default()
    };
    let bytes = cropped.bytes();
    let image = decode(&bytes).unwrap();
    assert_eq!((dimensions(&bytes).unwrap(), (image.width, image.height)), ((4, 2), (4, 2)));
    let inside = [0.5, 0.25, 2.0, 1.0];
    assert_eq!(image.pixels, [[0.0; 4], [0.0; 4], [0.0; 4], [0.0; 4], inside, inside, [0.0; 4], [0.0; 4]]);
    assert!(image.notes[0].contains("25 %"), "{:?}", image.notes);
    assert_eq!(decode(&Example::default().bytes()).unwrap().notes, Vec::<String>::new(), "the control");
    let outside = Example { data: IntegerBounds::new((90, 0), (4, 2)), ..Example::default() };
    assert!(decode(&outside.bytes()).unwrap_err().to_string().contains("outside its display window"));
}

#[test]
fn huge_display_windows_are_refused_before_allocation() {
    let huge = Example { display: IntegerBounds::new((0, 0), (1 << 20, 1 << 20)), ..Example::default() };
    assert!(decode(&huge.bytes()).unwrap_err().to_string().contains("display window"));
    assert!(decoded_bytes(&huge.bytes()).unwrap() > 1 << 40);
}

/// A file with one half channel `Y` whose header states a data window of `side` x `side` pixels.
fn with_stated_data_window(side: u32) -> Vec<u8> {
    let window = IntegerBounds::new((0, 0), (1, 1));
    let mut bytes =
        Example { data: window, display: window, channels: &[("Y", 0.5)], ..Example::default() }.bytes();
    let name = b"dataWindow\0box2i\0";
    let at = bytes.windows(name.len()).position(|w| w == name).unwrap() + name.len() + 4;
    let last = (side - 1).to_le_bytes();
    bytes[at + 8..at + 16].copy_from_slice(&[last, last].concat());
    bytes
}

#[test]
fn huge_data_windows_are_refused_before_allocation() {
    use crate::formats::image_file;
    let bytes = with_stated_data_window(1 << 15);
    assert_eq!(dimensions(&bytes).unwrap(), (1, 1), "the display window is small");
    assert!(decode(&bytes).unwrap_err().to_string().contains("data window"));
    let error = image_file::decode(&bytes, image_file::DEFAULT_MAX_PIXELS).unwrap_err();
    assert!(matches!(error, ImageFileError::TooManyPixels { width: 32_768, height: 32_768, .. }), "{error}");
    let large = Example {
        data: IntegerBounds::new((0, 0), (8, 8)),
        display: IntegerBounds::new((0, 0), (1, 1)),
        ..Example::default()
    };
    let limited = |limit| image_file::decode(&large.bytes(), limit);
    assert!(matches!(limited(63).unwrap_err(), ImageFileError::TooManyPixels { .. }));
    assert_eq!(limited(64).unwrap().pixels.len(), 1, "the control");
}

#[test]
fn tiles_and_scan_lines_of_every_sample_type_are_placed() {
    let (width, height) = (7usize, 5usize);
    let value = |k: usize| (0..width * height).map(move |i| (k * 100 + i) as f32);
    let channels = || {
        AnyChannels::sort(
            [
                AnyChannel::new("R", FlatSamples::F32(value(1).collect())),
                AnyChannel::new("G", FlatSamples::F16(value(2).map(f16::from_f32).collect())),
                AnyChannel::new("B", FlatSamples::U32(value(3).map(|v| v as u32).collect())),
                AnyChannel::new("Z", FlatSamples::F32(value(9).collect())),
            ]
            .into_iter()
            .collect(),
        )
    };
    let wanted: Vec<[f32; 4]> = (0..35u8)
        .map(|i| [100, 200, 300].map(|k: u16| f32::from(k + u16::from(i))))
        .map(|[r, g, b]| [r, g, b, 1.0])
        .collect();
    for blocks in [Blocks::ScanLines, Blocks::Tiles(Vec2(3, 2))] {
        let encoding = Encoding { compression: Compression::ZIP1, blocks, line_order: LineOrder::Increasing };
        let part = |name: &str| {
            WrittenLayer::new((width, height), LayerAttributes::named(name), encoding, channels())
        };
        let attributes = ImageAttributes::new(IntegerBounds::new((0, 0), (width, height)));
        let image = Image::empty(attributes).with_layer(part("other")).with_layer(part("beauty"));
        let mut out = Cursor::new(Vec::new());
        image.write().to_buffered(&mut out).unwrap();
        let bytes = out.into_inner();
        assert_eq!(decode(&bytes).unwrap().pixels, wanted, "{blocks:?}");
        assert_eq!(decoded_bytes(&bytes).unwrap(), 35 * (4 * 4 + 16), "one part and the pixels");
    }
}

#[test]
fn subsampled_chroma_is_refused_by_name() {
    let channels = [("BY", 0.0), ("RY", 0.0), ("Y", 0.5)];
    let mut bytes = Example { channels: &channels, ..Example::default() }.bytes();
    assert!(decode(&bytes).unwrap_err().to_string().contains("luminance and chroma"));
    for name in [b"BY\0", b"RY\0"] {
        let at = bytes.windows(3).position(|w| w == name).unwrap();
        // After the name: type, linearity, and the sampling of x and y.
        (bytes[at + 11], bytes[at + 15]) = (2, 2);
    }
    assert!(decode(&bytes).unwrap_err().to_string().contains("luminance and chroma"));
    let mut depth = Example { channels: &[("R", 0.5), ("Z", 1.0)], ..Example::default() }.bytes();
    let at = depth.windows(3).position(|w| w == b"Z\0\x02").unwrap();
    (depth[at + 10], depth[at + 14]) = (2, 2);
    assert!(decode(&depth).is_err());
}

#[test]
fn layout_of_environment_maps_is_read() {
    let cube = Example { environment: Some(EnvironmentMap::Cube), ..Example::default() };
    assert_eq!(decode(&cube.bytes()).unwrap().environment, Some(EnvironmentMap::Cube));
    assert_eq!(decode(&Example::default().bytes()).unwrap().environment, None);
}

#[test]
fn half_floats_are_read_exactly() {
    let samples = |value: f32| FlatSamples::F16(vec![f16::from_f32(value); 2]);
    let channels = [("R", 0.5), ("G", 1024.0), ("B", 65_504.0)];
    let channels = channels.map(|(name, value)| AnyChannel::new(name, samples(value)));
    let image = Image::from_channels((2, 1), AnyChannels::sort(channels.into_iter().collect()));
    let mut out = Cursor::new(Vec::new());
    image.write().to_buffered(&mut out).unwrap();
    assert_eq!(decode(&out.into_inner()).unwrap().pixels, [[0.5, 1024.0, 65_504.0, 1.0]; 2]);
}
