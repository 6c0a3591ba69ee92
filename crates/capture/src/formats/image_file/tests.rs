//! Tests of the image readers and writers.

use std::io::Cursor;

use image::{ExtendedColorType, ImageEncoder};

use super::*;
use crate::formats::ImageFileError;
use relume_scene::{BitDepth, DisplayRange, ImageRgba, srgb};

fn gradient() -> ImageRgba {
    let pixels =
        (0..12).map(|i| [i as f32 / 11.0, 0.25, 1.0 - i as f32 / 11.0, (i % 3) as f32 / 2.0]).collect();
    ImageRgba { width: 4, height: 3, pixels }
}

#[test]
fn eight_bit_png_round_trips_to_half_a_level() {
    let image = gradient();
    let back = decode(&encode_rgba(&image).unwrap(), 12).unwrap();
    for (a, b) in image.pixels.as_flattened().iter().zip(back.pixels.as_flattened()) {
        assert!((a - b).abs() <= 0.5 / 255.0 + 1e-6, "{a} {b}");
    }
}

#[test]
fn sixteen_bit_grey_png_keeps_its_precision() {
    let bytes = encode_png16(2, 1, &[[1u16], [40_001]]).unwrap();
    let back = decode(&bytes, 2).unwrap();
    assert_eq!(back.pixels[0][0], 1.0 / 65535.0);
    assert!((back.pixels[1][1] - 40_001.0 / 65535.0).abs() < 1e-7);
}

#[test]
fn bit_depth_is_read_from_the_file() {
    let eight = encode_png(1, 1, &[[1u8, 2, 3]]).unwrap();
    let sixteen = encode_png16(1, 1, &[[1u16, 2, 3]]).unwrap();
    let floats = tiff(1, 1, &[0; 12], ExtendedColorType::Rgb32F);
    let jpeg = encode_jpeg(8, 8, &[[9; 3]; 64], 90).unwrap();
    let found = [eight, jpeg, sixteen, floats].map(|bytes| bit_depth(&bytes).unwrap());
    assert_eq!(found, [BitDepth::Eight, BitDepth::Eight, BitDepth::Sixteen, BitDepth::Sixteen]);
    assert_eq!(bit_depth(b"").unwrap_err(), ImageFileError::Empty);
}

#[test]
fn jpeg_and_webp_are_detected_by_content() {
    let jpeg = encode_jpeg(16, 16, &[[200, 100, 50]; 256], 95).unwrap();
    let p = decode(&jpeg, 256).unwrap().pixels[17];
    assert!((p[0] - 200.0 / 255.0).abs() < 0.02 && p[3] == 1.0, "{p:?}");
    let mut webp = Vec::new();
    image::codecs::webp::WebPEncoder::new_lossless(&mut webp)
        .write_image(&[10, 20, 30, 40], 1, 1, ExtendedColorType::Rgba8)
        .unwrap();
    assert_eq!(decode(&webp, 1).unwrap().pixels[0], [10u8, 20, 30, 40].map(|v| f32::from(v) / 255.0));
}

fn tiff(width: u32, height: u32, samples: &[u8], kind: ExtendedColorType) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let encoder = image::codecs::tiff::TiffEncoder::new(&mut file);
    encoder.write_image(samples, width, height, kind).unwrap();
    file.into_inner()
}

#[test]
fn integer_tiff_is_display_encoded_and_float_tiff_is_linear() {
    let eight = tiff(2, 1, &[0, 51, 255, 102, 0, 204], ExtendedColorType::Rgb8);
    assert_eq!(dimensions(&eight).unwrap(), (2, 1));
    assert_eq!(decode(&eight, 2).unwrap().pixels, [[0.0, 0.2, 1.0, 1.0], [0.4, 0.0, 0.8, 1.0]]);
    let sixteen: Vec<u8> = [65_535u16, 1, 0, 32_768].iter().flat_map(|v| v.to_ne_bytes()).collect();
    let back = decode(&tiff(1, 1, &sixteen, ExtendedColorType::Rgba16), 1).unwrap().pixels[0];
    assert_eq!(back, [1.0, 1.0 / 65_535.0, 0.0, 32_768.0 / 65_535.0]);
    let light: Vec<u8> = [0.5f32, 7.0, f32::NAN].iter().flat_map(|v| v.to_ne_bytes()).collect();
    let back = decode(&tiff(1, 1, &light, ExtendedColorType::Rgb32F), 1).unwrap().pixels[0];
    assert_eq!([back[0], back[2], back[3]], [srgb::encode(0.5), 0.0, 1.0], "linear light, encoded");
    assert!(back[1] <= 1.0 && back[1] > 0.999_999, "and clamped: {}", back[1]);
    let photo = decode_photograph(&tiff(1, 1, &light, ExtendedColorType::Rgb32F), 1, |size| size).unwrap();
    assert_eq!(
        photo.image.pixels[0],
        [srgb::encode(0.5), srgb::encode_extended(7.0), 0.0, 1.0],
        "a photograph is not"
    );
    assert_eq!((photo.light.range, photo.light.limited), (DisplayRange::Extended, 0.0));
}

#[test]
fn truncated_or_corrupt_tiff_never_panics() {
    let whole = tiff(5, 4, &[77; 60], ExtendedColorType::Rgb8);
    assert!(decode(&whole, 19).is_err(), "more pixels than are allowed");
    for n in 0..whole.len() {
        assert!(decode(&whole[..n], 20).is_err(), "{n} bytes");
        for value in [0, 1, 0x7f, 0xff] {
            let mut bent = whole.clone();
            bent[n] = value;
            if let Ok(image) = decode(&bent, 20) {
                assert_eq!(image.pixels.len(), image.width as usize * image.height as usize);
            }
        }
    }
}

#[test]
fn reduction_while_decoding_equals_reduction_afterwards() {
    let image = gradient();
    let half = |(width, height): (u32, u32)| (width / 2, height.div_ceil(2));
    let (reduced, stored) = decode_reduced(&encode_rgba(&image).unwrap(), 12, half).unwrap();
    assert_eq!((stored, (reduced.width, reduced.height)), ((4, 3), (2, 2)));
    let whole = decode(&encode_rgba(&image).unwrap(), 12).unwrap();
    assert_eq!(reduced, whole.resized(2, 2));
    assert_ne!(reduced.pixels, whole.pixels[..4], "the control: not the unreduced pixels");
}

#[test]
fn too_large_header_is_refused_before_decoding() {
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    png.extend([0, 0, 0x4e, 0x20, 0, 0, 0x4e, 0x20, 8, 6, 0, 0, 0, 0, 0, 0, 0]);
    let error = decode(&png, DEFAULT_MAX_PIXELS).unwrap_err();
    assert!(matches!(error, ImageFileError::TooManyPixels { width: 20_000, height: 20_000, .. }));
}

#[test]
fn empty_text_and_truncated_files_give_clear_errors() {
    assert_eq!(decode(b"", 1).unwrap_err(), ImageFileError::Empty);
    let text = decode(b"hello, I am a picture", 1).unwrap_err();
    assert!(text.to_string().contains("hello"), "{text}");
    let whole = encode_rgba(&gradient()).unwrap();
    let cut = decode(&whole[..whole.len() - 30], 12).unwrap_err();
    assert!(matches!(cut, ImageFileError::Damaged(_)), "{cut}");
}

#[test]
fn encoder_refuses_pixel_buffers_of_wrong_length() {
    assert!(encode_png(2, 2, &[[0u8; 3]; 3]).is_err());
    assert!(encode_png(1, 1, &[[0u8; 2]; 1]).is_err());
    assert!(encode_jpeg(0, 0, &[], 90).is_err());
}
