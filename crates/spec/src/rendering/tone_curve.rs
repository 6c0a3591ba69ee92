//! Conversion of scene-referred colours to display colours.

use serde::{Deserialize, Serialize};

use relume_scene::srgb;

/// Tone curve: conversion of unbounded radiance to display values.
///
/// `srgb`: clamped to 1, sRGB curve. `neutral`: Khronos PBR Neutral. `agx`: AgX, base look. `linear`: clamped
/// to 1, no curve, 16-bit PNG only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, Default, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ToneCurve {
    /// Clamped to 1, sRGB curve. Evaluations use this curve.
    #[default]
    Srgb,
    /// Compresses highlights without a hue shift (Khronos PBR Neutral). Colours below 0.76 are unchanged
    /// apart from a small offset.
    Neutral,
    /// Film-like curve over 16.5 stops that desaturates bright colours (AgX, base look).
    Agx,
    /// Clamped to 1, no curve, 16 bits. PNG only.
    Linear,
}

impl ToneCurve {
    /// Converts linear Rec.709 radiance with straight alpha to display values in [0, 1]. NaN becomes 0.
    pub fn apply(self, colour: [f32; 3]) -> [f32; 3] {
        match self {
            Self::Linear => colour.map(|v| positive(v).min(1.0)),
            curve => curve.light(colour).map(srgb::encode),
        }
    }

    /// Converts to linear display light, before encoding. The encoding clamps the result.
    pub fn light(self, colour: [f32; 3]) -> [f32; 3] {
        match self {
            Self::Neutral => neutral(colour.map(positive)),
            Self::Agx => agx(colour.map(positive)),
            Self::Srgb | Self::Linear => colour,
        }
    }
}

fn positive(v: f32) -> f32 {
    // Not `clamp`, which lets NaN through.
    if v > 0.0 { v.min(f32::MAX) } else { 0.0 }
}

/// Khronos PBR Neutral tone mapper, specification of 2024, section 3.
fn neutral(colour: [f32; 3]) -> [f32; 3] {
    /// Reflectance of a dielectric at normal incidence, which the curve subtracts.
    const F90: f32 = 0.04;
    const START: f32 = 0.8 - F90;
    const DESATURATION: f32 = 0.15;
    let least = colour.into_iter().fold(f32::INFINITY, f32::min);
    let offset = if least < 2.0 * F90 { least - least * least / (4.0 * F90) } else { F90 };
    let colour = colour.map(|v| v - offset);
    let peak = colour.into_iter().fold(0.0, f32::max);
    if peak < START {
        return colour;
    }
    let headroom = 1.0 - START;
    let lower = 1.0 - headroom * headroom / (peak + headroom - START);
    let pale = 1.0 - 1.0 / (DESATURATION * (peak - lower) + 1.0);
    // The ratio first: the product with a peak near the largest float would overflow.
    colour.map(|v| v / peak * lower * (1.0 - pale) + lower * pale)
}

/// AgX, base look: inset of the primaries, sigmoid over stops, inverse of the inset (T. Sobotka, 2022).
fn agx(colour: [f32; 3]) -> [f32; 3] {
    /// Share of each colour that is replaced by a weighted mean of all channels, and the weights of the mean,
    /// with sum 1.
    const INSET: f32 = 0.2;
    const MIXED: [f32; 3] = [0.212_005, 0.392_183, 0.395_812];
    /// Stops below and above middle grey.
    const STOPS: [f32; 2] = [-10.0, 6.5];
    const MIDDLE_GREY: f32 = 0.18;
    /// Display exponent for which the curve is defined.
    const DISPLAY: f32 = 2.2;
    let mixed = |c: [f32; 3]| c.iter().zip(MIXED).map(|(v, w)| v * w).sum::<f32>();
    let mean = mixed(colour);
    let curved = colour.map(|v| {
        let stops = ((1.0 - INSET) * v + INSET * mean).max(f32::MIN_POSITIVE) / MIDDLE_GREY;
        sigmoid(((stops.log2() - STOPS[0]) / (STOPS[1] - STOPS[0])).clamp(0.0, 1.0))
    });
    let mean = mixed(curved);
    curved.map(|v| ((v - INSET * mean) / (1.0 - INSET)).clamp(0.0, 1.0).powf(DISPLAY))
}

/// The curve of AgX on [0, 1] through (0, 0), middle grey at (20/33, 1/2) with slope 2, and (1, 1).
fn sigmoid(x: f32) -> f32 {
    const GREY: f32 = 20.0 / 33.0;
    let side = |reach: f32, power: f32| {
        let bend = ((4.0 * reach).powf(power) - 1.0) / reach.powf(power);
        2.0 * (x - GREY) * (1.0 + bend * (x - GREY).abs().powf(power)).powf(-1.0 / power)
    };
    0.5 + if x < GREY { side(GREY, 3.0) } else { side(1.0 - GREY, 3.25) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [ToneCurve; 4] = [ToneCurve::Srgb, ToneCurve::Neutral, ToneCurve::Agx, ToneCurve::Linear];

    #[test]
    fn tone_curves_accept_any_input_and_keep_grey_monotonic() {
        for curve in ALL {
            let mut last = -1.0;
            for v in [0.0, 1e-30, 1e-3, 0.05, 0.18, 0.5, 0.75, 0.9, 1.0, 2.0, 20.0, 1e4, 1e30, f32::MAX] {
                let [r, g, b] = curve.apply([v; 3]);
                assert!((r - g).abs() < 1e-5 && (g - b).abs() < 1e-5, "{curve:?} {v}: {r} {g} {b}");
                assert!((0.0..=1.0).contains(&r) && r >= last - 1e-6, "{curve:?} {v}: {r} after {last}");
                last = r;
            }
            for odd in [[f32::NAN; 3], [f32::INFINITY, 0.0, -1.0], [f32::MAX, f32::MAX, 0.0], [-5.0; 3]] {
                assert!(curve.apply(odd).iter().all(|v| (0.0..=1.0).contains(v)), "{curve:?} {odd:?}");
            }
        }
    }

    #[test]
    fn agx_curve_passes_through_its_three_reference_points() {
        for (x, y) in [(0.0, 0.0), (20.0 / 33.0, 0.5), (1.0, 1.0)] {
            assert!((sigmoid(x) - y).abs() < 1e-5, "{x}: {}", sigmoid(x));
        }
        let slope = (sigmoid(20.0 / 33.0 + 1e-3) - sigmoid(20.0 / 33.0 - 1e-3)) / 2e-3;
        assert!((slope - 2.0).abs() < 0.01, "{slope}");
        let [grey, ..] = agx([0.18; 3]);
        assert!((grey - 0.5f32.powf(2.2)).abs() < 1e-4);
    }

    #[test]
    fn neutral_curve_keeps_dark_colours_and_bright_hues() {
        let dim = neutral([0.5, 0.3, 0.2]);
        assert_eq!(dim, [0.5 - 0.04, 0.3 - 0.04, 0.2 - 0.04]);
        let [r, g, b] = neutral([8.0, 4.04, 0.08]);
        assert!(r < 1.0 && r > g && g > b, "{r} {g} {b}");
        let [r, g, _] = ToneCurve::Srgb.apply([8.0, 4.04, 0.08]);
        assert!(r == g && g > 0.999, "the control: clamped, orange is yellow");
    }
}
