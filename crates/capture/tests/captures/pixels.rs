//! Pixels of photographs: colour profiles, truncated files, raw files and pictures of phones.

use std::io::Cursor;
use std::path::Path;
use std::process::Command;

use image::{ExtendedColorType, ImageEncoder};
use moxcms::ColorProfile;
use relume_capture::check::{FindingKind, check_photographs};
use relume_capture::formats::image_file::{self, decode, decode_photograph, encode_jpeg, encode_png};
use relume_capture::formats::{ColourConversion, ImageFileError};
use relume_capture::{CaptureError, ImportLimits, ImportOptions, PhotosWithoutPoses, inspect};
use relume_fixtures::small_set::{Files, import_folder, nerfstudio};
use relume_scene::srgb;
use relume_spec::CaptureReport;

const SIZE: (u32, u32) = (8, 6);

/// A PNG of one colour with an ICC profile.
fn png_with_profile(colour: [u8; 3], profile: Vec<u8>) -> Vec<u8> {
    let mut out = Vec::new();
    let mut encoder = image::codecs::png::PngEncoder::new(&mut out);
    encoder.set_icc_profile(profile).unwrap();
    encoder.write_image([colour; 48].as_flattened(), SIZE.0, SIZE.1, ExtendedColorType::Rgb8).unwrap();
    out
}

/// A JPEG of one colour with an ICC profile in its segment APP2.
fn jpeg_with_profile(colour: [u8; 3], profile: &[u8]) -> Vec<u8> {
    let jpeg = encode_jpeg(SIZE.0, SIZE.1, &[colour; 48], 100).unwrap();
    let length = ((profile.len() + 16) as u16).to_be_bytes();
    [&jpeg[..2], &[0xff, 0xe2], &length, b"ICC_PROFILE\0\x01\x01", profile, &jpeg[2..]].concat()
}

/// A PNG of one colour with a chunk before its pixels. Readers check the checksum of the chunk.
fn png_with_chunk(colour: [u8; 3], kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
    const HEADER: usize = 8 + 25;
    let png = encode_png(SIZE.0, SIZE.1, &[colour; 48]).unwrap();
    let body = [&kind[..], data].concat();
    let mut checksum = flate2::Crc::new();
    checksum.update(&body);
    let length = (data.len() as u32).to_be_bytes();
    [&png[..HEADER], &length, &body, &checksum.sum().to_be_bytes(), &png[HEADER..]].concat()
}

/// The first pixel of a photograph in 255ths, and the conversion.
fn first(bytes: &[u8]) -> ([f32; 3], ColourConversion) {
    let photo = decode_photograph(bytes, 1 << 20, |size| size).unwrap();
    ([0, 1, 2].map(|k: usize| photo.image.pixels[0][k] * 255.0), photo.colour)
}

fn is_near(found: [f32; 3], wanted: [f32; 3]) -> bool {
    found.iter().zip(wanted).all(|(a, b)| (a - b).abs() <= 1.0)
}

fn converted(name: &str) -> ColourConversion {
    ColourConversion::Converted(name.to_owned())
}

/// The sRGB value, in 255ths, of a value of Display P3: both have the curve of sRGB and the white D65.
fn srgb_of_p3(colour: [u8; 3]) -> [f32; 3] {
    const MATRIX: [[f32; 3]; 3] = [
        [1.224_940_1, -0.224_940_2, 0.0],
        [-0.042_056_9, 1.042_057_1, 0.0],
        [-0.019_637_6, -0.078_636_1, 1.098_273_5],
    ];
    let light = colour.map(|v| srgb::decode(f32::from(v) / 255.0));
    MATRIX.map(|row| {
        255.0 * srgb::encode(row.iter().zip(light).map(|(m, v)| m * v).sum::<f32>().clamp(0.0, 1.0))
    })
}

#[test]
fn display_p3_is_converted_in_every_format() {
    let profile = ColorProfile::new_display_p3().encode().unwrap();
    // Pure red of sRGB, a colour inside sRGB, and one outside.
    for (colour, name) in [([234u8, 51, 35], "red"), ([200, 120, 60], "inside"), ([255, 0, 0], "outside")] {
        let (found, colour_note) = first(&png_with_profile(colour, profile.clone()));
        assert!(is_near(found, srgb_of_p3(colour)), "{name}: {found:?} {:?}", srgb_of_p3(colour));
        assert_eq!(colour_note, converted("Display P3"));
        let jpeg = jpeg_with_profile(colour, &profile);
        let stored = decode(&jpeg, 48).unwrap().pixels[0].map(|v| (v * 255.0).round() as u8);
        let (found, _) = first(&jpeg);
        assert!(is_near(found, srgb_of_p3([stored[0], stored[1], stored[2]])), "{name}: {found:?}");
        let (found, _) = first(&png_with_chunk(colour, b"cICP", &[12, 13, 0, 1]));
        assert!(is_near(found, srgb_of_p3(colour)), "{name}, cICP: {found:?}");
    }
    let (red, _) = first(&png_with_profile([234, 51, 35], profile));
    assert!(is_near(red, [255.0, 0.0, 0.0]), "{red:?}");
}

#[test]
fn adobe_and_prophoto_red_become_the_red_of_srgb() {
    for (profile, colour) in
        [(ColorProfile::new_adobe_rgb(), [219, 0, 0]), (ColorProfile::new_pro_photo_rgb(), [179, 70, 26])]
    {
        let (found, _) = first(&png_with_profile(colour, profile.encode().unwrap()));
        assert!(found[0] >= 254.0 && found[1] < 12.0 && found[2] < 12.0, "{colour:?}: {found:?}");
    }
}

#[test]
fn sixteen_bit_files_keep_their_precision() {
    let mut png = Vec::new();
    let mut encoder = image::codecs::png::PngEncoder::new(&mut png);
    encoder.set_icc_profile(ColorProfile::new_display_p3().encode().unwrap()).unwrap();
    let samples: Vec<u8> = [30_000u16, 30_100, 30_200].iter().flat_map(|v| v.to_ne_bytes()).collect();
    encoder.write_image(&samples, 1, 1, ExtendedColorType::Rgb16).unwrap();
    let (found, colour) = first(&png);
    assert_eq!(colour, converted("Display P3"));
    // Nearly grey, so the values nearly stay; 8 bits would round them to multiples of 1.
    assert!(found.iter().all(|v| (v - 117.1).abs() < 0.5), "{found:?}");
    assert!(found.iter().any(|v| (v - v.round()).abs() > 0.05), "{found:?}");
}

#[test]
fn profiles_that_are_srgb_in_effect_change_no_byte() {
    let mut curve = ColorProfile::new_srgb();
    // The curve of sRGB as a table and another name, as many programs write it.
    let table =
        (0..1024).map(|i| (srgb::decode(i as f32 / 1023.0) * 65_535.0).round() as u16).collect::<Vec<_>>();
    let table = Some(moxcms::ToneReprCurve::Lut(table));
    (curve.red_trc, curve.green_trc, curve.blue_trc) = (table.clone(), table.clone(), table);
    curve.description = ColorProfile::new_display_p3().description;
    for profile in [ColorProfile::new_srgb(), curve] {
        for colour in [[234u8, 51, 35], [3, 5, 9], [250, 130, 77]] {
            let (found, note) = first(&png_with_profile(colour, profile.encode().unwrap()));
            assert_eq!((found, note), (colour.map(f32::from), ColourConversion::None));
        }
    }
    let gamma = 45_455u32.to_be_bytes();
    assert_eq!(first(&png_with_chunk([9, 8, 7], b"gAMA", &gamma)).0, [9.0, 8.0, 7.0]);
    assert_eq!(first(&png_with_chunk([9, 8, 7], b"cICP", &[1, 13, 0, 1])).0, [9.0, 8.0, 7.0]);
    let corners = |corners: [u32; 6]| -> Vec<u8> {
        [31_270, 32_900].iter().chain(&corners).flat_map(|v| v.to_be_bytes()).collect()
    };
    let srgb = corners([64_000, 33_000, 30_000, 60_000, 15_000, 6_000]);
    assert_eq!(first(&png_with_chunk([234, 51, 35], b"cHRM", &srgb)).0, [234.0, 51.0, 35.0]);
    let p3 = corners([68_000, 32_000, 26_500, 69_000, 15_000, 6_000]);
    let (found, _) = first(&png_with_chunk([234, 51, 35], b"cHRM", &p3));
    assert!(is_near(found, [255.0, 0.0, 0.0]), "the control: {found:?}");
}

#[test]
fn curves_of_grey_profiles_and_png_gamma_are_converted() {
    // (20 / 255)^2.2 is 0.003706 of the light, which sRGB encodes as 12.0.
    let mut grey = Vec::new();
    let mut encoder = image::codecs::png::PngEncoder::new(&mut grey);
    encoder.set_icc_profile(ColorProfile::new_gray_with_gamma(2.2).encode().unwrap()).unwrap();
    encoder.write_image(&[20, 255], 2, 1, ExtendedColorType::L8).unwrap();
    let (found, note) = first(&grey);
    assert!(
        is_near(found, [12.0; 3]) && matches!(note, ColourConversion::Converted(_)),
        "{found:?} {note:?}"
    );
    // Linear light of 0.2 is 123.7.
    let (found, note) = first(&png_with_chunk([51; 3], b"gAMA", &100_000u32.to_be_bytes()));
    assert!(
        is_near(found, [123.7; 3]) && matches!(note, ColourConversion::Converted(_)),
        "{found:?} {note:?}"
    );
}

#[test]
fn unusable_profiles_are_ignored_with_a_reason() {
    let mut cmyk = ColorProfile::new_srgb().encode().unwrap();
    cmyk[16..20].copy_from_slice(b"CMYK");
    let grey = ColorProfile::new_gray_with_gamma(2.2).encode().unwrap();
    let whole = ColorProfile::new_display_p3().encode().unwrap();
    let cut = whole[..whole.len() / 2].to_vec();
    for (profile, word) in
        [(cmyk, "CMYK"), (grey, "grey"), (cut, "damaged"), (b"no profile".to_vec(), "damaged")]
    {
        let (found, note) = first(&png_with_profile([234, 51, 35], profile));
        assert_eq!(found, [234.0, 51.0, 35.0]);
        assert!(
            matches!(&note, ColourConversion::Ignored { reason, .. } if reason.contains(word)),
            "{word}: {note:?}"
        );
    }
    let (found, note) = first(&png_with_chunk([234, 51, 35], b"cICP", &[9, 16, 0, 1]));
    assert_eq!(found, [234.0, 51.0, 35.0]);
    assert!(matches!(&note, ColourConversion::Ignored { reason, .. } if reason.contains("PQ")), "{note:?}");
}

/// Files in a folder.
fn folder_of(files: &Files) -> tempfile::TempDir {
    let folder = tempfile::TempDir::new().unwrap();
    for (name, bytes) in files {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    folder
}

/// The report of a capture.
fn inspected(files: &Files) -> CaptureReport {
    inspect(folder_of(files).path(), &ImportOptions::default()).unwrap()
}

#[test]
fn photographs_are_converted_and_masks_are_not() {
    let mut files = nerfstudio(|_| ());
    let p3 = ColorProfile::new_display_p3().encode().unwrap();
    for i in 0..6 {
        files.insert(format!("images/{i}.png"), png_with_profile([200 + i, 120, 60], p3.clone()));
        let mut mask = Vec::new();
        let mut encoder = image::codecs::png::PngEncoder::new(&mut mask);
        encoder.set_icc_profile(ColorProfile::new_gray_with_gamma(1.0).encode().unwrap()).unwrap();
        encoder.write_image(&[204; 48], 8, 6, ExtendedColorType::L8).unwrap();
        files.insert(format!("masks/{i}.png"), mask);
    }
    let capture = import_folder(&files).unwrap();
    let view = capture.train.iter().find(|view| view.name == "images/1.png").unwrap();
    let pixel = view.image.pixel(20).map(|v| v * 255.0);
    assert!(is_near([pixel[0], pixel[1], pixel[2]], srgb_of_p3([201, 120, 60])), "{pixel:?}");
    assert!((pixel[3] - 204.0).abs() < 0.6, "the mask has its own values: {pixel:?}");
    let report = inspected(&files);
    let note = report.notes.iter().find(|note| note.text.contains("Display P3")).unwrap();
    assert!(note.text.contains("converted to sRGB") && note.photographs.len() == 6, "{note:?}");
    let plain = inspected(&nerfstudio(|_| ()));
    assert!(plain.notes.iter().all(|note| !note.text.contains("profile")), "the control: {:?}", plain.notes);
}

fn refusal(change: impl FnOnce(&mut Files)) -> String {
    let mut files = nerfstudio(|_| ());
    change(&mut files);
    let error = import_folder(&files).unwrap_err();
    assert!(matches!(error, CaptureError::Image { .. }), "{error:?}");
    error.to_string()
}

#[test]
fn truncated_jpeg_is_refused_by_name() {
    let pixels: Vec<[u8; 3]> = (0..48).map(|i| [i * 5, 255 - i * 3, i * 4 % 19]).collect();
    let jpeg = encode_jpeg(8, 6, &pixels, 90).unwrap();
    let text =
        refusal(|files| drop(files.insert("images/2.png".to_owned(), jpeg[..jpeg.len() - 9].to_vec())));
    assert!(text.contains("images/2.png") && text.contains("truncated"), "{text}");
    let mut files = nerfstudio(|_| ());
    files.insert("images/2.png".to_owned(), [&jpeg[..], b"\0\0\0\x18ftypmp42 a clip"].concat());
    assert!(import_folder(&files).is_ok(), "a motion photo has a clip after its picture");
}

#[test]
fn truncated_webp_is_refused() {
    let pixels: Vec<u8> = (0..64 * 48 * 3u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let mut webp = Vec::new();
    let encoder = image::codecs::webp::WebPEncoder::new_lossless(&mut webp);
    encoder.write_image(&pixels, 64, 48, ExtendedColorType::Rgb8).unwrap();
    assert!(decode(&webp, 1 << 20).is_ok(), "the control");
    for length in [webp.len() / 3, webp.len() / 2, webp.len() - 20] {
        assert!(decode(&webp[..length], 1 << 20).is_err(), "{length} of {} bytes", webp.len());
    }
}

#[test]
fn raw_files_and_unread_images_are_refused_by_kind() {
    let mut tiff = Cursor::new(Vec::new());
    let encoder = image::codecs::tiff::TiffEncoder::new(&mut tiff);
    encoder.write_image(&[77; 144], 8, 6, ExtendedColorType::Rgb8).unwrap();
    let mut tiff = tiff.into_inner();
    let mut files = nerfstudio(|_| ());
    files.insert("images/2.png".to_owned(), tiff.clone());
    assert!(import_folder(&files).is_ok(), "the control: a plain TIFF");
    // The first entry of the directory becomes DNGVersion.
    let at = u32::from_le_bytes(tiff[4..8].try_into().unwrap()) as usize;
    tiff[at + 2..at + 4].copy_from_slice(&50_706u16.to_le_bytes());
    let text = refusal(|files| drop(files.insert("images/2.png".to_owned(), tiff)));
    assert!(text.contains("images/2.png") && text.contains("DNG") && text.contains("JPEG"), "{text}");
    let text = refusal(|files| drop(files.insert("images/2.png".to_owned(), b"GIF89a\x08\0\x06\0".to_vec())));
    assert!(text.contains("GIF image") && text.contains("convert"), "{text}");
}

/// Problems and hints of the check of files without poses.
fn findings(files: &Files) -> (Vec<String>, Vec<String>) {
    let folder = folder_of(files);
    let photographs = PhotosWithoutPoses::open(folder.path(), &ImportLimits::default()).unwrap().unwrap();
    let found = check_photographs(&photographs).findings;
    let (problems, hints): (Vec<_>, Vec<_>) = found.into_iter().partition(|finding| finding.is_problem());
    let texts = |found: Vec<relume_capture::check::Finding>| found.into_iter().map(|f| f.text).collect();
    (texts(problems), texts(hints))
}

/// Fourteen photographs of noise; the first `different` differ, the others are copies of the first.
fn noise(different: u32) -> Files {
    let value = |i: u32, p: u32| (((p * 31 + i + 1).wrapping_mul(2_654_435_761)) >> 24) as u8;
    let picture = |i: u32| {
        let i = if i < different { i } else { 0 };
        let pixels: Vec<[u8; 3]> =
            (0..32 * 24).map(|p| [value(i, p), value(i, p + 1), value(i, p + 2)]).collect();
        encode_png(32, 24, &pixels).unwrap()
    };
    (0..14).map(|i| (format!("images/{i:02}.png"), picture(i))).collect()
}

#[test]
fn identical_photographs_are_a_problem() {
    let has = |texts: &[String]| texts.iter().any(|text| text.contains("identical copies"));
    let (problems, _) = findings(&noise(1));
    assert!(has(&problems), "{problems:?}");
    let (problems, hints) = findings(&noise(13));
    assert!(!has(&problems) && has(&hints), "{problems:?} {hints:?}");
    let (problems, hints) = findings(&noise(14));
    assert!(!has(&problems) && !has(&hints), "the control: {hints:?}");
}

#[test]
fn image_files_that_are_no_photographs_are_noted() {
    let mut files = noise(14);
    for i in 0..14 {
        files.insert(format!("images_2/{i:02}.png"), encode_png(16, 12, &[[i as u8; 3]; 192]).unwrap());
    }
    let folder = folder_of(&files);
    let photographs = PhotosWithoutPoses::open(folder.path(), &ImportLimits::default()).unwrap().unwrap();
    let found = check_photographs(&photographs).findings;
    let note = found.iter().find(|finding| finding.text.contains("not used as photographs")).unwrap();
    assert!(note.text.contains("photographs: 14;") && note.text.contains("reduced copy"), "{note:?}");
    assert_eq!(note.kind, FindingKind::Note, "nothing has to be done");
    let small = found.iter().find(|finding| finding.text.contains("are small")).unwrap();
    assert_eq!(small.kind, FindingKind::Hint, "the control");
    let raws: Files = (0..3).map(|i| (format!("IMG_{i}.NEF"), b"II*\0".to_vec())).collect();
    let text =
        PhotosWithoutPoses::open(folder_of(&raws).path(), &ImportLimits::default()).unwrap_err().to_string();
    assert!(text.contains("raw files of a camera: 3") && text.contains("develop"), "{text}");
}

/// A profile as libpng requires it: of a multiple of 4 bytes, with exactly the illuminant D50.
fn strict(mut profile: Vec<u8>) -> Vec<u8> {
    profile.resize(profile.len().next_multiple_of(4), 0);
    let length = (profile.len() as u32).to_be_bytes();
    profile[..4].copy_from_slice(&length);
    profile[68..80].copy_from_slice(&[0, 0, 0xf6, 0xd6, 0, 1, 0, 0, 0, 0, 0xd3, 0x2d]);
    profile
}

/// Makes a HEIC or AVIF file of an image file with heif-enc.
fn encoded(png: &[u8], folder: &Path, name: &str) -> Vec<u8> {
    let (input, output) = (folder.join("in.png"), folder.join(name));
    std::fs::write(&input, png).unwrap();
    let status = Command::new("heif-enc").args(["-q", "100", "-o"]).args([&output, &input]).status().unwrap();
    assert!(status.success());
    std::fs::read(output).unwrap()
}

#[test]
#[ignore = "needs heif-enc and heif-convert (Debian: libheif-examples)"]
fn phone_pictures_are_read_by_content_with_their_profile() {
    let folder = tempfile::TempDir::new().unwrap();
    let p3 = strict(ColorProfile::new_display_p3().encode().unwrap());
    let (plain, wide) = ([200u8, 120, 60], srgb_of_p3([200, 120, 60]));
    for name in ["a.heic", "a.avif"] {
        let tagged = encoded(&png_with_profile(plain, p3.clone()), folder.path(), name);
        assert_eq!(image_file::dimensions(&tagged).unwrap(), SIZE);
        let (found, note) = first(&tagged);
        let is_near = |wanted: [f32; 3]| found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 4.0);
        assert!(is_near(wide) && note == converted("Display P3"), "{name}: {found:?} {wide:?} {note:?}");
        assert!(!is_near(plain.map(f32::from)), "the control");
        let mut files = nerfstudio(|_| ());
        files.insert("images/2.png".to_owned(), tagged.clone());
        let capture = import_folder(&files).unwrap();
        assert!(capture.train.iter().chain(&capture.test).any(|view| view.name == "images/2.png"));
        let cut = decode(&tagged[..tagged.len() - 40], 1 << 20).unwrap_err();
        assert!(matches!(cut, ImageFileError::Damaged(_)), "{cut}");
        assert!(matches!(decode(&tagged, 47).unwrap_err(), ImageFileError::TooManyPixels { .. }));
    }
}
