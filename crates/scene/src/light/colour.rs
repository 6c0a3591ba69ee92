//! Chromaticity of a light, independent of its level.

use serde::{Deserialize, Serialize};

use relume_layout::light::LUMINANCE;

/// Chromaticity of a light as two natural logarithms, both 0 for a neutral light.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct LightColour {
    /// `ln(blue / red)`: negative for warm lights.
    pub blue_over_red: f32,
    /// `ln(green^2 / (red blue))`: negative for pinkish lights.
    pub green: f32,
}

impl LightColour {
    /// Equal in all channels.
    pub const NEUTRAL: Self = Self { blue_over_red: 0.0, green: 0.0 };

    /// The chromaticity of a light with linear Rec.709 channels above 0.
    pub fn of(rgb: [f32; 3]) -> Self {
        let [red, green, blue] = rgb.map(f32::ln);
        Self { blue_over_red: blue - red, green: 2.0 * green - red - blue }
    }

    /// Linear Rec.709 channels of luminance 1.
    pub fn rgb(self) -> [f32; 3] {
        let half = self.blue_over_red / 2.0;
        let channels = [(-half).exp(), (self.green / 2.0).exp(), half.exp()];
        let level = luminance(channels);
        channels.map(|c| c / level)
    }

    /// A black body at `kelvin`, 1,667 to 25,000, as photographs balanced for 6,504 K show it (Kim et al. 2002,
    /// US 7024034, cubic splines of the Planckian locus).
    pub fn black_body(kelvin: f32) -> Self {
        let of = |kelvin: f32| Self::of(planckian(f64::from(kelvin)).map(|v| v.max(1e-3) as f32));
        let (body, balance) = (of(kelvin), of(6_504.0));
        Self { blue_over_red: body.blue_over_red - balance.blue_over_red, green: body.green - balance.green }
    }
}

/// Luminance of linear Rec.709 channels.
pub fn luminance(rgb: [f32; 3]) -> f32 {
    rgb.iter().zip(LUMINANCE).map(|(c, share)| c * share).sum()
}

/// Linear Rec.709 channels of a black body, up to a factor.
fn planckian(kelvin: f64) -> [f64; 3] {
    let t = kelvin.clamp(1_667.0, 25_000.0);
    let cubic = |c: [f64; 4], x: f64| ((c[0] * x + c[1]) * x + c[2]) * x + c[3];
    let x = match t <= 4_000.0 {
        true => cubic([-0.266_123_9e9, -0.234_358_9e6, 0.877_695_6e3, 0.179_910], 1.0 / t),
        false => cubic([-3.025_846_9e9, 2.107_037_9e6, 0.222_634_7e3, 0.240_390], 1.0 / t),
    };
    let y = if t <= 2_222.0 {
        cubic([-1.106_381_4, -1.348_110_2, 2.185_558_32, -0.202_196_83], x)
    } else if t <= 4_000.0 {
        cubic([-0.954_947_6, -1.374_185_93, 2.091_370_15, -0.167_488_67], x)
    } else {
        cubic([3.081_758, -5.873_386_7, 3.751_129_97, -0.370_014_83], x)
    };
    let (big_x, big_z) = (x / y, (1.0 - x - y) / y);
    [
        3.240_970 * big_x - 1.537_383 - 0.498_611 * big_z,
        -0.969_244 * big_x + 1.875_968 + 0.041_555 * big_z,
        0.055_630 * big_x - 0.203_977 + 1.056_972 * big_z,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_colour_is_independent_of_brightness() {
        let colour = LightColour::of([0.8, 0.9, 1.3]);
        let rgb = colour.rgb();
        assert!((luminance(rgb) - 1.0).abs() < 1e-5);
        let level = luminance([0.8, 0.9, 1.3]);
        assert!((0..3).all(|c| (rgb[c] * level - [0.8, 0.9, 1.3][c]).abs() < 1e-5));
        assert_eq!(LightColour::of([2.0; 3]), LightColour::NEUTRAL);
    }

    #[test]
    fn black_body_colours_get_bluer_and_are_neutral_at_6504_kelvin() {
        let at = |kelvin: f32| LightColour::black_body(kelvin);
        assert!(at(6_504.0).blue_over_red.abs() < 1e-6 && at(6_504.0).green.abs() < 1e-6);
        let steps: Vec<f32> =
            [2_000.0, 2_700.0, 4_000.0, 4_001.0, 5_500.0, 10_000.0].map(|k| at(k).blue_over_red).to_vec();
        assert!(steps.windows(2).all(|pair| pair[0] < pair[1]), "{steps:?}");
        // Planck's law through the CIE 1931 observer: 2,856 K (illuminant A) has linear sRGB 1 : 0.43 : 0.11 by D65.
        assert!((at(2_856.0).blue_over_red - (0.112f32).ln()).abs() < 0.25, "{:?}", at(2_856.0));
    }
}
