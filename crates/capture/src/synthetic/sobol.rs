//! Low-discrepancy number pairs: the first two Sobol dimensions with hashed Owen scrambling.
//!
//! Each `key` scrambles values and order differently. Pairs of different keys are independent; the pairs of one
//! key are evenly distributed over the square for every power of two.

use glam::DVec2;

/// The `index`-th pair in [0, 1) of the sequence `key`.
pub(super) fn pair(index: u32, key: u64) -> DVec2 {
    let (order, values) = (key as u32, (key >> 32) as u32);
    let shuffled = scrambled(index, order);
    let x = scrambled(shuffled.reverse_bits(), values);
    let y = scrambled(second_dimension(shuffled), values ^ 0x6a09_e667);
    DVec2::new(f64::from(x), f64::from(y)) / f64::from(u32::MAX).next_up()
}

/// Sobol's second dimension: its generator matrix is Pascal's triangle modulo 2.
fn second_dimension(mut index: u32) -> u32 {
    let (mut sum, mut column) = (0, 1u32 << 31);
    while index != 0 {
        if index & 1 == 1 {
            sum ^= column;
        }
        column ^= column >> 1;
        index >>= 1;
    }
    sum
}

/// Owen scrambling by a hash: each bit is flipped by a hash of the bits above it. The bits are reversed because
/// multiplications carry from low to high.
fn scrambled(bits: u32, seed: u32) -> u32 {
    let mut x = bits.reverse_bits();
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed).wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^= x.wrapping_mul(0x53a2_2864);
    x.reverse_bits()
}

/// A bijective scrambler of 64 bits (splitmix64's finaliser).
pub(super) fn mix(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixty_four_pairs_fill_each_elementary_interval_once() {
        for key in [0, 1, mix(7), u64::MAX] {
            for (columns, rows) in [(64, 1), (1, 64), (8, 8), (16, 4), (4, 16)] {
                let mut seen = vec![0; 64];
                for i in 0..64 {
                    let p = pair(i, key);
                    assert!((0.0..1.0).contains(&p.x) && (0.0..1.0).contains(&p.y));
                    seen[(p.x * columns as f64) as usize * rows + (p.y * rows as f64) as usize] += 1;
                }
                assert!(seen.iter().all(|&n| n == 1), "{key} {columns}x{rows}");
            }
        }
    }

    #[test]
    fn sequences_of_different_keys_are_uncorrelated() {
        let correlation: f64 =
            (0..4096).map(|i| (pair(i, mix(1)).x - 0.5) * (pair(i, mix(2)).x - 0.5) * 12.0 / 4096.0).sum();
        assert!(correlation.abs() < 0.06, "{correlation}");
    }
}
