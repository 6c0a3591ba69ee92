//! Large zeroed buffers. All threads zero them: the first access to a page is expensive, and a single thread would make the
//! others wait.

use rayon::prelude::*;

/// Floats that a thread zeroes at once.
const RUN: usize = 1024;

/// `n` zeros.
pub fn zeros(n: usize) -> Vec<f32> {
    let runs: Vec<[f32; RUN]> =
        (0..n.div_ceil(RUN)).into_par_iter().with_min_len(16).map(|_| [0.0; RUN]).collect();
    let mut out = runs.into_flattened();
    out.truncate(n);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zeros_has_the_requested_length_and_only_zeros() {
        for n in [0, 1, RUN - 1, RUN, 40 * RUN + 7] {
            let out = zeros(n);
            assert!(out.len() == n && out.iter().all(|v| v.to_bits() == 0), "{n}");
        }
    }
}
