//! The sRGB transfer curve (IEC 61966-2-1), values in [0, 1], and its continuation above 1.

use std::sync::LazyLock;

use crate::DisplayRange;

/// Linear light to the sRGB-encoded value; clamps to [0, 1], NaN becomes 0.
pub fn encode(linear: f32) -> f32 {
    let x = unit(linear);
    if x <= 0.003_130_8 { 12.92 * x } else { (1.055 * x.powf(1.0 / 2.4) - 0.055).min(1.0) }
}

/// Linear light to the value in [`DisplayRange::Extended`]: the value of [`encode`] up to 1; above 1 the power of the curve
/// continues. Clamps to that range, NaN becomes 0.
pub fn encode_extended(linear: f32) -> f32 {
    if linear > 1.0 {
        let range = DisplayRange::Extended;
        (1.055 * linear.min(range.peak()).powf(1.0 / 2.4) - 0.055).clamp(1.0, range.white())
    } else {
        encode(linear)
    }
}

/// An sRGB-encoded value to linear light; clamps to [0, 1], NaN becomes 0.
pub fn decode(encoded: f32) -> f32 {
    let x = unit(encoded);
    if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

fn unit(x: f32) -> f32 {
    // Not `clamp`, which keeps NaN.
    if x > 0.0 { x.min(1.0) } else { 0.0 }
}

/// A value in [0, 1] as the nearest of 256 levels.
pub fn to_u8(x: f32) -> u8 {
    (x * 255.0 + 0.5) as u8
}

/// Number of low bits of an f32 in which the numbers of a bucket differ.
const WITHIN: u32 = 16;
/// Smaller numbers have level 0.
const MIN_BUCKETED: f32 = 1.0 / 8192.0;

/// Numbers with equal leading bits. Numbers below `border` have `level`, the others the next level.
#[derive(Debug, Clone, Copy)]
struct Bucket {
    border: f32,
    level: u8,
}

/// Buckets of [`MIN_BUCKETED`] to 1, each narrow enough to contain at most one border between levels.
static BUCKETS: LazyLock<Vec<Bucket>> = LazyLock::new(|| {
    let level = |x: f32| to_u8(encode(x));
    let buckets = (MIN_BUCKETED.to_bits() >> WITHIN)..(1.0f32.to_bits() >> WITHIN);
    let bucket = |leading: u32| {
        let (first, end) = (leading << WITHIN, (leading + 1) << WITHIN);
        let below = level(f32::from_bits(first));
        let (mut low, mut high) = (first, end);
        while low < high {
            let middle = (low + high) / 2;
            if level(f32::from_bits(middle)) > below { high = middle } else { low = middle + 1 }
        }
        Bucket { border: f32::from_bits(low), level: below }
    };
    buckets.map(bucket).collect()
});

/// Linear light to the nearest of 256 sRGB-encoded levels: [`to_u8`] of [`encode`], by table instead of a power.
#[inline]
pub fn encode_u8(linear: f32) -> u8 {
    if !(linear >= MIN_BUCKETED) {
        return 0;
    }
    match BUCKETS.get(((linear.to_bits() - MIN_BUCKETED.to_bits()) >> WITHIN) as usize) {
        Some(bucket) => bucket.level + u8::from(linear >= bucket.border),
        None => u8::MAX,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_encoding_to_u8_matches_the_power_function() {
        let all = (0..1.0f32.to_bits() + (1 << 24)).step_by(997).map(f32::from_bits);
        for x in all.chain([-1.0, 1.0, 1e30, f32::INFINITY, f32::NAN, f32::NEG_INFINITY]) {
            assert_eq!(encode_u8(x), to_u8(encode(x)), "{x}");
        }
        // Each border and the numbers next to it, where the power may round to either side.
        for level in 0..255u8 {
            let at = decode((f32::from(level) + 0.5) / 255.0);
            for bits in at.to_bits() - 40..at.to_bits() + 40 {
                let found = encode_u8(f32::from_bits(bits));
                assert!(found == level || found == level + 1);
            }
            assert_eq!(encode_u8(at * 0.9999), level);
            assert_eq!(encode_u8(at * 1.0001), level + 1);
        }
    }

    #[test]
    fn extended_curve_equals_the_curve_up_to_1_and_is_bounded() {
        for x in (0..=1.0f32.to_bits()).step_by(997).map(f32::from_bits).chain([-1.0, f32::NAN, 1.0]) {
            assert_eq!(encode_extended(x).to_bits(), encode(x).to_bits(), "{x}");
        }
        let above = [1.0, 1.000_001, 1.5, 8.0, 63.9].map(encode_extended);
        assert!(above.is_sorted() && above[2] > 1.15, "{above:?}");
        assert!(encode(8.0) <= 1.0, "the control: the curve is clamped");
        for x in [64.0, 1e30, f32::INFINITY] {
            assert!((encode_extended(x) - DisplayRange::Extended.white()).abs() < 1e-6, "{x}");
        }
    }

    #[test]
    fn all_256_levels_round_trip() {
        for level in 0..=255u8 {
            assert_eq!(to_u8(encode(decode(f32::from(level) / 255.0))), level);
        }
    }

    #[test]
    fn mid_grey_matches_the_standard_and_nan_becomes_black() {
        assert!((decode(0.5) - 0.214_041).abs() < 1e-5);
        assert_eq!((encode(f32::NAN), decode(f32::NAN), decode(7.0)), (0.0, 0.0, 1.0));
        assert!((encode(7.0) - 1.0).abs() < 1e-6);
    }
}
