use std::io::Write;

use flate2::{Compression, write::GzEncoder};

use crate::formats::splat_import::decode;
use crate::formats::splats::{Splats, Y_0};
use relume_scene::Field;

/// The blocks of two splats of SH degree 1, with 3 or 4 bytes a rotation.
fn blocks(rotations: &[u8]) -> Vec<Vec<u8>> {
    let fixed = |v: i32| v.to_le_bytes()[..3].to_vec();
    vec![
        // 12 bits after the point.
        [4096, -8192, 2048, -4096, 0, 0].into_iter().flat_map(fixed).collect(),
        vec![255, 51],
        vec![255, 128, 0, 0, 0, 0],
        vec![160, 144, 128, 160, 160, 160],
        rotations.to_vec(),
        vec![128, 64, 128, 255, 128, 128, 0, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128, 128],
    ]
}

fn header(version: u32, flags: u8, streams: u8) -> Vec<u8> {
    [&b"NGSP"[..], &version.to_le_bytes(), &2u32.to_le_bytes(), &[1, 12, flags, streams]].concat()
}

fn raw(version: u32, flags: u8) -> Vec<u8> {
    let rotations: &[u8] = if version == 2 { &V2_ROTATIONS } else { &V3_ROTATIONS };
    [header(version, flags, 0), blocks(rotations).concat()].concat()
}

/// The identity, and a half turn about x.
const V2_ROTATIONS: [u8; 6] = [128, 128, 128, 255, 128, 128];
/// The identity (largest component w), and a quarter turn about x with the sign of w negative.
const V3_ROTATIONS: [u8; 8] = [0, 0, 0, 0xc0, 0xff, 0x03, 0, 0];

fn gzipped(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// A Zstandard frame with one raw block (RFC 8878, sections 3.1.1 and 3.1.1.2).
fn zstd(bytes: &[u8]) -> Vec<u8> {
    let block = ((bytes.len() as u32) << 3 | 1).to_le_bytes();
    let frame = [&[0x28, 0xb5, 0x2f, 0xfd, 0x20, bytes.len() as u8][..], &block[..3], bytes];
    frame.concat()
}

/// A file of version 4.
pub(in crate::formats::splat_import) fn version_4() -> Vec<u8> {
    let blocks = blocks(&V3_ROTATIONS);
    let streams: Vec<Vec<u8>> = blocks.iter().map(|block| zstd(block)).collect();
    let mut out = [header(4, 1, 6), 32u32.to_le_bytes().to_vec(), vec![0; 12]].concat();
    for (block, stream) in blocks.iter().zip(&streams) {
        out.extend((stream.len() as u64).to_le_bytes());
        out.extend((block.len() as u64).to_le_bytes());
    }
    [out, streams.concat()].concat()
}

/// A file of version 2.
pub(in crate::formats::splat_import) fn version_2() -> Vec<u8> {
    gzipped(&raw(2, 0))
}

fn near(a: &[f32], b: &[f32]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4)
}

#[test]
fn attributes_are_unpacked() {
    let model = decode(&version_2()).unwrap().model;
    let splats = Splats::of(&model);
    assert!(near(&splats.positions[0].to_array(), &[1.0, -2.0, 0.5]));
    assert!(near(&splats.positions[1].to_array(), &[-1.0, 0.0, 0.0]));
    assert!(splats.opacity(0) == 1.0 && (splats.opacity(1) - 0.2).abs() < 1e-5);
    assert!(near(&splats.log_scales[0], &[0.0, -1.0, -2.0]));
    let red = 0.5 + Y_0 * splats.harmonics(0)[0][0];
    assert!((red - (0.5 + Y_0 * 0.5 / 0.15)).abs() < 1e-5, "{red}");
    assert_eq!(splats.harmonics(0)[1], [0.0, -0.5, 0.0], "channels of the first coefficient");
    assert_eq!(splats.harmonics(0)[2][0], 127.0 / 128.0);
    assert_eq!(splats.harmonics(0)[3][0], -1.0);
    assert_eq!(model.card["imported"]["from"], "spz");
}

#[test]
fn rotations_of_all_versions_are_read() {
    let quaternion = |bytes: &[u8], i| decode(bytes).unwrap().model.gaussians.get::<4>(Field::Quaternion, i);
    let close = |a: [f32; 4], b: [f32; 4]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 0.01);
    assert!(close(quaternion(&version_2(), 0), [1.0, 0.0, 0.0, 0.0]));
    assert!(close(quaternion(&version_2(), 1), [0.0, 1.0, 0.0, 0.0]));
    let half = std::f32::consts::FRAC_1_SQRT_2;
    for bytes in [gzipped(&raw(3, 0)), raw(3, 0), version_4()] {
        assert!(close(quaternion(&bytes, 0), [1.0, 0.0, 0.0, 0.0]));
        assert!(close(quaternion(&bytes, 1), [-half, half, 0.0, 0.0]), "{:?}", quaternion(&bytes, 1));
    }
}

#[test]
fn antialiased_flag_sets_the_compensation() {
    let is_mip = |bytes: &[u8]| decode(bytes).unwrap().model.shading.low_pass_compensation;
    assert!(is_mip(&version_4()) && is_mip(&gzipped(&raw(2, 1))));
    assert!(!is_mip(&version_2()), "the control");
    let notes = decode(&gzipped(&raw(3, 2))).unwrap().notes;
    assert!(notes[0].contains("extensions"), "{notes:?}");
}

#[test]
fn truncated_files_are_refused() {
    for whole in [raw(2, 0), gzipped(&raw(3, 0)), version_4()] {
        assert!(decode(&whole).is_ok());
        for cut in 0..whole.len() - 16 {
            assert!(decode(&whole[..cut]).is_err(), "cut at {cut} of {}", whole.len());
        }
    }
}

#[test]
fn fields_out_of_range_are_named() {
    let refused = |at: usize, value: u8| {
        let mut bytes = raw(3, 0);
        bytes[at] = value;
        decode(&bytes).unwrap_err().to_string()
    };
    assert!(refused(4, 1).contains("version") && refused(4, 9).contains("version"));
    assert!(refused(11, 0x7f).contains("number of splats"));
    assert!(refused(12, 5).contains("SH degree"));
    assert!(refused(13, 60).contains("fractional bits"));
    assert!(refused(8, 3).contains("truncated"), "{}", refused(8, 3));
    let mut streams = version_4();
    streams[15] = 5;
    assert!(decode(&streams).unwrap_err().to_string().contains("number of streams"));
    let mut contents = version_4();
    contents[16] = 31;
    assert!(decode(&contents).unwrap_err().to_string().contains("table of contents"));
    let mut length = version_4();
    length[40] = 1;
    assert!(decode(&length).unwrap_err().to_string().contains("positions"));
}
