//! Random changes of colour profiles.

use image::DynamicImage;
use moxcms::ColorProfile;
use proptest::prelude::*;

use super::stated::StatedColour;
use super::{ColourConversion, convert};
use relume_fixtures::cases_or;

/// A profile of RGB with one tag.
fn profile(pcs: &[u8; 4], tag: &[u8]) -> Vec<u8> {
    let mut out = vec![0; 128];
    let length = (128 + 16 + tag.len()) as u32;
    out[..4].copy_from_slice(&length.to_be_bytes());
    out[8..12].copy_from_slice(&[4, 0x30, 0, 0]);
    out[12..24].copy_from_slice(&[b"scnrRGB ", &pcs[..]].concat());
    out[36..40].copy_from_slice(b"acsp");
    out[68..80].copy_from_slice(&[0, 0, 0xf6, 0xd6, 0, 1, 0, 0, 0, 0, 0xd3, 0x2d]);
    out.extend(
        [1u32.to_be_bytes(), *b"A2B0", 144u32.to_be_bytes(), (tag.len() as u32).to_be_bytes()].concat(),
    );
    out.extend(tag);
    out
}

fn shorts(values: &[u16]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_be_bytes()).collect()
}

/// The corners of a table of 2 x 2 x 2 colours, inverted.
fn corners() -> Vec<u8> {
    let value = |i: u16, bit: u16| if i >> bit & 1 == 1 { 9_000 } else { 50_000 };
    shorts(&(0..8).flat_map(|i| [value(i, 2), value(i, 1), value(i, 0)]).collect::<Vec<_>>())
}

/// A profile with a table of 16 bits (lut16Type).
fn with_table() -> Vec<u8> {
    let identity = [1u32 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 16].map(u32::to_be_bytes);
    let ramps = shorts(&[0, 65_535, 0, 65_535, 0, 65_535]);
    let head = [b"mft2".as_slice(), &[0; 4], &[3, 3, 2, 0], identity.as_flattened(), &[0, 2, 0, 2]].concat();
    profile(b"Lab ", &[head, ramps.clone(), corners(), ramps].concat())
}

/// A profile with curves and a table (lutAToBType).
fn with_curves_and_table() -> Vec<u8> {
    let curves = [&b"curv\0\0\0\0\0\0\0\0"[..]; 3].concat();
    let table = [&[2, 2, 2][..], &[0; 13], &[2, 0, 0, 0], &corners()].concat();
    let (b, clut) = (32, 32 + curves.len() as u32);
    let a = clut + table.len() as u32;
    let offsets = [b, 0, 0, clut, a].map(u32::to_be_bytes);
    let head = [b"mAB ".as_slice(), &[0; 4], &[3, 3, 0, 0], offsets.as_flattened()].concat();
    profile(b"Lab ", &[head, curves.clone(), table, curves].concat())
}

/// One-pixel pictures of every kind.
fn pictures() -> Vec<DynamicImage> {
    let kinds = [
        image::ColorType::L8,
        image::ColorType::La16,
        image::ColorType::Rgb8,
        image::ColorType::Rgba16,
        image::ColorType::Rgb32F,
    ];
    kinds.map(|kind| DynamicImage::new(1, 1, kind)).to_vec()
}

#[test]
fn profiles_with_tables_are_converted() {
    for icc in [with_table(), with_curves_and_table()] {
        let mut picture =
            DynamicImage::ImageRgb8(image::RgbImage::from_pixel(1, 1, image::Rgb([0, 200, 90])));
        let before = picture.clone();
        let found = convert(&mut picture, &StatedColour::Icc(icc));
        assert_eq!(found, ColourConversion::Converted("without a name".to_owned()));
        assert_ne!(picture, before, "the table inverts");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(cases_or(60)))]

    #[test]
    fn changed_profiles_cause_no_panic(
        seed in 0usize..5,
        picture in 0usize..5,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in prop::option::weighted(0.1, any::<prop::sample::Index>()),
    ) {
        let seeds = [
            with_table(),
            with_curves_and_table(),
            ColorProfile::new_display_p3().encode().unwrap(),
            ColorProfile::new_adobe_rgb().encode().unwrap(),
            ColorProfile::new_gray_with_gamma(2.2).encode().unwrap(),
        ];
        let mut icc = seeds[seed].clone();
        for (at, value) in changes {
            let at = at.index(icc.len());
            icc[at] = value;
        }
        if let Some(cut) = cut {
            icc.truncate(cut.index(icc.len()));
        }
        convert(&mut pictures()[picture], &StatedColour::Icc(icc));
    }
}
