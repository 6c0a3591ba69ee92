//! The sRGB transfer curve (IEC 61966-2-1), values in [0, 1].

/// Linear light to the sRGB-encoded value; clamps to [0, 1], NaN becomes 0.
pub fn encode(linear: f32) -> f32 {
    let x = unit(linear);
    if x <= 0.003_130_8 { 12.92 * x } else { (1.055 * x.powf(1.0 / 2.4) - 0.055).min(1.0) }
}

/// An sRGB-encoded value to linear light; clamps to [0, 1], NaN becomes 0.
pub fn decode(encoded: f32) -> f32 {
    let x = unit(encoded);
    if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

fn unit(x: f32) -> f32 {
    // Not `clamp`, which lets NaN through.
    if x > 0.0 { x.min(1.0) } else { 0.0 }
}

/// A value in [0, 1] as the nearest of 256 levels.
pub fn to_u8(x: f32) -> u8 {
    (x * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_256_levels_round_trip() {
        for level in 0..=255u8 {
            assert_eq!(to_u8(encode(decode(f32::from(level) / 255.0))), level);
        }
    }

    #[test]
    fn mid_grey_is_where_the_standard_puts_it_and_nan_is_black() {
        assert!((decode(0.5) - 0.214_041).abs() < 1e-5);
        assert_eq!((encode(f32::NAN), decode(f32::NAN), decode(7.0)), (0.0, 0.0, 1.0));
        assert!((encode(7.0) - 1.0).abs() < 1e-6);
    }
}
