//! Makes colour profiles of the colour spaces that files state.

use moxcms::{
    Chromaticity, CicpColorPrimaries, CicpProfile, ColorPrimaries, ColorProfile, DataColorSpace,
    MatrixCoefficients, ParsingOptions, ProfileText, ToneReprCurve, TransferCharacteristics,
};

use super::stated::StatedColour;

/// Limits on an ICC profile, which is untrusted: bytes of the profile and of a table in it, values of a curve.
const LIMITS: ParsingOptions = ParsingOptions {
    max_profile_size: 4 << 20,
    max_allowed_clut_size: 4 << 20,
    max_allowed_trc_size: 65_536,
};
/// Characters of a profile's name that are kept.
const MAX_NAME: usize = 64;

/// Greatest number of tags of a profile.
const MAX_TAGS: usize = 128;
/// Greatest total length of the texts of a tag, bytes.
const MAX_TEXT: usize = 1 << 20;
/// Greatest difference of the primaries of equal colour spaces, CIE XYZ.
const SAME_COLORANTS: f64 = 0.003;

/// A colour profile with its name.
pub(super) struct NamedProfile {
    pub name: String,
    pub profile: ColorProfile,
}

/// A profile that cannot be used, and the reason.
#[derive(Debug, PartialEq)]
pub(super) struct Unusable {
    pub name: String,
    pub reason: &'static str,
}

/// The profile of a stated colour space.
pub(super) fn profile_of(stated: &StatedColour) -> Result<NamedProfile, Unusable> {
    match stated {
        StatedColour::Icc(bytes) => from_icc(bytes),
        StatedColour::Coded { primaries, transfer } => from_codes(*primaries, *transfer),
        StatedColour::Measured { gamma, chromaticities } => Ok(from_chunks(*gamma, *chromaticities)),
        StatedColour::AdobeRgb => {
            Ok(NamedProfile { name: "Adobe RGB".to_owned(), profile: ColorProfile::new_adobe_rgb() })
        }
    }
}

fn from_icc(bytes: &[u8]) -> Result<NamedProfile, Unusable> {
    if !has_moderate_tags(bytes) {
        return Err(Unusable { name: "ICC".to_owned(), reason: "it is damaged" });
    }
    let Ok(profile) = ColorProfile::new_from_slice_with_options(bytes, LIMITS) else {
        return Err(Unusable { name: "ICC".to_owned(), reason: "it is damaged" });
    };
    let name = name(&profile);
    match profile.color_space {
        DataColorSpace::Rgb | DataColorSpace::Gray => Ok(NamedProfile { name, profile }),
        DataColorSpace::Cmyk => Err(Unusable { name, reason: "it is a CMYK profile" }),
        DataColorSpace::Lab => Err(Unusable { name, reason: "it is a Lab profile" }),
        _ => Err(Unusable { name, reason: "it is neither an RGB nor a grey profile" }),
    }
}

/// Whether the tags of a profile stay within limits that the parser does not check: their number, and the total length of the
/// texts of a tag, which can all refer to the same bytes (ICC.1:2022, sections 7.3 and 10.15).
fn has_moderate_tags(bytes: &[u8]) -> bool {
    const HEADER: usize = 128;
    let number =
        |at: usize| -> Option<usize> { Some(u32::from_be_bytes(*bytes.get(at..)?.first_chunk()?) as usize) };
    let is_moderate = |i: usize| {
        let entry = HEADER + 4 + 12 * i;
        let (Some(at), Some(length)) = (number(entry + 4), number(entry + 8)) else { return false };
        let is_text = bytes.get(at..).is_some_and(|data| data.starts_with(b"mluc"));
        !is_text || number(at + 8).is_some_and(|texts| texts.saturating_mul(length) <= MAX_TEXT)
    };
    number(HEADER).is_some_and(|count| count <= MAX_TAGS && (0..count).all(is_moderate))
}

/// The description of a profile without control characters, or the known space with its primaries.
fn name(profile: &ColorProfile) -> String {
    let text = match &profile.description {
        Some(ProfileText::PlainString(text)) => text.as_str(),
        Some(ProfileText::Localizable(texts)) => {
            let english = texts.iter().find(|text| text.language == "en").or(texts.first());
            english.map_or("", |text| &text.value)
        }
        Some(ProfileText::Description(text)) if text.ascii_string.is_empty() => &text.unicode_string,
        Some(ProfileText::Description(text)) => &text.ascii_string,
        None => "",
    };
    let text: String = text.chars().filter(|c| !c.is_control()).take(MAX_NAME).collect();
    if text.trim().is_empty() { name_of_primaries(profile) } else { text.trim().to_owned() }
}

fn name_of_primaries(profile: &ColorProfile) -> String {
    let known = [
        ("Display P3", ColorProfile::new_display_p3()),
        ("Adobe RGB", ColorProfile::new_adobe_rgb()),
        ("ProPhoto RGB", ColorProfile::new_pro_photo_rgb()),
        ("BT.2020", ColorProfile::new_bt2020()),
    ];
    let own = profile.colorant_matrix().v;
    let is_near = |other: &ColorProfile| {
        let pairs = own.as_flattened().iter().zip(other.colorant_matrix().v.as_flattened().to_vec());
        pairs.into_iter().all(|(a, b)| (a - b).abs() < SAME_COLORANTS)
    };
    match known.iter().find(|(_, other)| is_near(other)) {
        Some((name, _)) => (*name).to_owned(),
        None => "without a name".to_owned(),
    }
}

/// The colour space of primaries and a transfer function, codes of ITU-T H.273, tables 2 and 3.
fn from_codes(primaries: u8, transfer: u8) -> Result<NamedProfile, Unusable> {
    let name = match primaries {
        1 | 2 => "sRGB".to_owned(),
        9 => "BT.2020".to_owned(),
        11 => "DCI-P3".to_owned(),
        12 => "Display P3".to_owned(),
        other => format!("with primaries {other} of H.273"),
    };
    let unusable = |reason| Err(Unusable { name: name.clone(), reason });
    let mut profile = ColorProfile::new_srgb();
    if !matches!(primaries, 1 | 2) {
        let Ok(color_primaries) = CicpColorPrimaries::try_from(primaries) else {
            return unusable("its primaries are unknown");
        };
        let (srgb, matrix_coefficients) = (TransferCharacteristics::Srgb, MatrixCoefficients::Identity);
        let codes = CicpProfile {
            color_primaries,
            transfer_characteristics: srgb,
            matrix_coefficients,
            full_range: true,
        };
        profile.cicp = None;
        profile.update_rgb_colorimetry_from_cicp(codes);
        // The profile has the codes only if they have primaries.
        if profile.cicp.is_none() {
            return unusable("its primaries are unknown");
        }
        set_curve(&mut profile, ColorProfile::new_srgb().red_trc);
    }
    profile.cicp = None;
    let curve = match transfer {
        // Players show pictures with the camera curves of television as they show sRGB.
        1 | 2 | 6 | 13 | 14 | 15 => None,
        4 => power(2.2),
        5 => power(2.8),
        8 => power(1.0),
        16 | 18 => {
            return unusable("it is a high dynamic range picture (PQ or HLG): save it as a standard one");
        }
        _ => return unusable("its transfer function is unknown"),
    };
    if curve.is_some() {
        set_curve(&mut profile, curve);
    }
    Ok(NamedProfile { name, profile })
}

fn from_chunks(gamma: Option<f64>, chromaticities: Option<[[f64; 2]; 4]>) -> NamedProfile {
    let mut profile = ColorProfile::new_srgb();
    profile.cicp = None;
    if let Some(corners) = chromaticities {
        let [white, red, green, blue] = corners.map(|[x, y]| Chromaticity { x: x as f32, y: y as f32 });
        profile.update_rgb_colorimetry(white.to_xyyb(), ColorPrimaries { red, green, blue });
    }
    if let Some(gamma) = gamma {
        set_curve(&mut profile, power((1.0 / gamma) as f32));
    }
    let name = match gamma {
        Some(gamma) => format!("of a PNG with gamma {gamma:.3}"),
        None => "of a PNG with its own primaries".to_owned(),
    };
    NamedProfile { name, profile }
}

/// The curve `light = value^exponent`.
fn power(exponent: f32) -> Option<ToneReprCurve> {
    Some(ToneReprCurve::Parametric(vec![exponent]))
}

fn set_curve(profile: &mut ColorProfile, curve: Option<ToneReprCurve>) {
    profile.red_trc = curve.clone();
    profile.green_trc = curve.clone();
    profile.blue_trc = curve;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profiles_without_a_name_are_named_by_their_primaries() {
        let mut profile = ColorProfile::new_display_p3();
        profile.description = None;
        let named = |profile: &ColorProfile| from_icc(&profile.encode().unwrap()).map(|found| found.name);
        assert_eq!(named(&profile), Ok("Display P3".to_owned()));
        profile.red_colorant.x += 0.1;
        assert_eq!(named(&profile), Ok("without a name".to_owned()), "the control");
    }

    #[test]
    fn tags_that_would_take_much_memory_are_refused() {
        let whole = ColorProfile::new_display_p3().encode().unwrap();
        assert!(has_moderate_tags(&whole));
        let text = whole.windows(4).position(|bytes| bytes == b"mluc").unwrap();
        let mut texts = whole.clone();
        texts[text + 8..text + 12].copy_from_slice(&u32::MAX.to_be_bytes());
        let mut tags = whole.clone();
        tags[128..132].copy_from_slice(&[0, 1, 0, 0]);
        for changed in [texts, tags] {
            assert!(!has_moderate_tags(&changed));
        }
    }

    #[test]
    fn truncated_and_changed_profiles_never_panic() {
        let whole = ColorProfile::new_display_p3().encode().unwrap();
        for at in 0..whole.len() {
            assert!(from_icc(&whole[..at]).is_err() || at > 132, "{at}");
            for value in [0, 1, 0x7f, 0xff] {
                let mut changed = whole.clone();
                changed[at] = value;
                let _ = from_icc(&changed);
            }
        }
    }
}
