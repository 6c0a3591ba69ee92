//! Sixteen pixels of a tile row at once, as plain arrays that the compiler turns into vector registers.
//!
//! Everything here is `inline(always)`, so that it is compiled with the CPU features of the calling kernel (`multiversion`
//! compiles each kernel once per feature set and chooses at run time).

/// Values in a vector: pixels of a tile row, or Gaussians.
pub const LANES: usize = 16;

/// One value per pixel of a strip.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
pub struct Lanes(pub [f32; LANES]);

impl Lanes {
    /// All zero.
    pub const ZERO: Self = Self([0.0; LANES]);
    /// All one.
    pub const ONE: Self = Self([1.0; LANES]);

    /// `f(lane)` for each lane.
    #[inline(always)]
    pub fn from_fn(f: impl Fn(usize) -> f32) -> Self {
        let mut out = [0.0; LANES];
        for i in 0..LANES {
            out[i] = f(i);
        }
        Self(out)
    }

    /// A copy of sixteen floats.
    #[inline(always)]
    pub fn load(source: &[f32]) -> Self {
        let mut out = [0.0; LANES];
        out.copy_from_slice(&source[..LANES]);
        Self(out)
    }

    /// `self + a * b`. Product and sum round separately: a fused operation would be faster on CPUs that have it, but the bytes
    /// would differ from those of other CPUs.
    #[inline(always)]
    pub fn add_product(&mut self, a: f32, b: &Self) {
        for i in 0..LANES {
            self.0[i] += a * b.0[i];
        }
    }

    /// `self + a * b`, lane by lane.
    #[inline(always)]
    pub fn add_products(&mut self, a: &Self, b: &Self) {
        for i in 0..LANES {
            self.0[i] += a.0[i] * b.0[i];
        }
    }

    /// The sum of the lanes, always in the same order: halves, quarters, eighths.
    #[inline(always)]
    pub fn sum(&self) -> f32 {
        let mut v = self.0;
        let mut width = LANES / 2;
        while width > 0 {
            for i in 0..width {
                v[i] += v[i + width];
            }
            width /= 2;
        }
        v[0]
    }

    /// The largest lane.
    #[inline(always)]
    pub fn max(&self) -> f32 {
        let mut v = self.0;
        let mut width = LANES / 2;
        while width > 0 {
            for i in 0..width {
                v[i] = if v[i] > v[i + width] { v[i] } else { v[i + width] };
            }
            width /= 2;
        }
        v[0]
    }
}

/// [`Lanes::sum`] of each of four.
///
/// Not inlined: behind a loop that fills the four, the compiler would move the sums' tree into that loop and vectorise across
/// the four, by shuffles and gathers.
#[inline(never)]
pub fn totals(v: &[Lanes; 4]) -> [f32; 4] {
    v.each_ref().map(Lanes::sum)
}

/// `e^x` for x <= 0, relative error below 3e-7; 0 below -87.
///
/// `2^round(t) * 2^fraction`, the fraction by a degree-6 polynomial, rounding by the 1.5 * 2^23 trick, so
/// that everything stays in vector registers. The last bits of the shifted number hold the rounded value at the position of
/// the exponent. This avoids a conversion, which in Rust saturates and needs comparisons.
#[inline(always)]
pub fn exp_negative(x: f32) -> f32 {
    const MAGIC: f32 = 12_582_912.0;
    let clamped = if x > -87.0 { x } else { -87.0 };
    let t = clamped * std::f32::consts::LOG2_E;
    let shifted = t + MAGIC;
    let f = t - (shifted - MAGIC);
    let mut p = 1.540_353e-4;
    p = p * f + 1.333_355_8e-3;
    p = p * f + 9.618_129e-3;
    p = p * f + 5.550_411e-2;
    p = p * f + 2.402_265e-1;
    p = p * f + std::f32::consts::LN_2;
    p = p * f + 1.0;
    let scale = f32::from_bits((shifted.to_bits() << 23).wrapping_add(127 << 23));
    if x > -87.0 { p * scale } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_is_accurate_over_its_range() {
        for i in 0..87_000 {
            let x = -(i as f32) / 1000.0;
            let exact = f64::from(x).exp();
            let error = (f64::from(exp_negative(x)) - exact).abs() / exact.max(1e-37);
            assert!(error < 6e-7 * (1.0 + f64::from(-x) * 0.2), "{x}: {error}");
        }
        assert_eq!(exp_negative(-1e30), 0.0);
        assert_eq!(exp_negative(f32::NEG_INFINITY), 0.0);
    }

    #[test]
    fn sum_and_maximum_use_every_lane() {
        let v = Lanes::from_fn(|i| i as f32);
        assert_eq!((v.sum(), v.max()), (120.0, 15.0));
    }
}
