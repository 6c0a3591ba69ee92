//! Aggregation (Eq. 24): the term that makes each Gaussian use one prototype. Sixteen Gaussians in SIMD lanes.

use multiversion::multiversion;
use rayon::prelude::*;

use crate::Gradients;
use crate::cpu::objective::sum;
use crate::cpu::{LANES, Lanes, softmax_lanes};
use relume_layout::constants::AGGREGATION_EPSILON as EPSILON;
use relume_scene::{Field, Gaussians};

/// `-mean ln Q` with `Q = sum_k p_k prod_{j != k} (1 - p_j)`; adds its gradient, returns its value.
pub fn aggregation(g: &Gaussians, weight: f32, out: &mut Gradients) -> f32 {
    if weight == 0.0 || g.is_empty() {
        return 0.0;
    }
    let (k, scale) = (g.prototypes(), weight / g.len() as f32);
    let (row, range) = (out.layout.row, out.layout.range(Field::ProtoLogits));
    let scores = g.field(Field::ProtoLogits).par_chunks(LANES * k);
    let blocks = out.rows.par_chunks_mut(LANES * row).zip(scores).with_min_len(4);
    let of_block = |[p, by]: &mut [Vec<Lanes>; 2], (rows, scores): (&mut [f32], &[f32])| {
        p.resize(k, Lanes::ZERO);
        by.resize(k, Lanes::ZERO);
        for (lane, scores) in scores.chunks_exact(k).enumerate() {
            p.iter_mut().zip(scores).for_each(|(p, s)| p.0[lane] = *s);
        }
        let q = of_sixteen(p, by, scale);
        let mut value = 0.0f64;
        for (lane, row) in rows.chunks_exact_mut(row).enumerate() {
            row[range.clone()].iter_mut().zip(&*by).for_each(|(o, g)| *o += g.0[lane]);
            value += f64::from(-scale * q.0[lane].ln());
        }
        value as f32
    };
    sum(&blocks.map_init(Default::default, of_block).collect::<Vec<f32>>())
}

/// Turns scores into shares, fills `by` with the gradient of `-scale ln Q` by the scores, and returns `Q`, at least
/// [`EPSILON`], where its derivative is 0.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
fn of_sixteen(p: &mut [Lanes], by: &mut [Lanes], scale: f32) -> Lanes {
    softmax_lanes(p);
    let rest = |v: f32| if 1.0 - v > EPSILON { 1.0 - v } else { EPSILON };
    // prod_{j != k} (1 - p_j) = all / (1 - p_k); the divisor is at least epsilon.
    let mut all = Lanes::ONE;
    for p in p.iter() {
        (0..LANES).for_each(|i| all.0[i] *= rest(p.0[i]));
    }
    let mut q = Lanes::ZERO;
    for p in p.iter() {
        (0..LANES).for_each(|i| q.0[i] += p.0[i] * all.0[i] / rest(p.0[i]));
    }
    // dQ/dp_m = prod_{j != m} - (1 / (1 - p_m)) sum_{k != m} p_k prod_{j != k}, the second part where unclamped.
    let mut mean = Lanes::ZERO;
    for (by, p) in by.iter_mut().zip(p.iter()) {
        *by = Lanes::from_fn(|i| {
            let own = all.0[i] / rest(p.0[i]);
            let others = q.0[i] - p.0[i] * own;
            let through = if 1.0 - p.0[i] > EPSILON { others / rest(p.0[i]) } else { 0.0 };
            -scale / q.0[i] * (own - through)
        });
        mean.add_products(p, by);
    }
    for (by, p) in by.iter_mut().zip(p.iter()) {
        *by = Lanes::from_fn(|i| if q.0[i] > EPSILON { p.0[i] * (by.0[i] - mean.0[i]) } else { 0.0 });
    }
    Lanes::from_fn(|i| if q.0[i] > EPSILON { q.0[i] } else { EPSILON })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Value and gradient for Gaussians with these scores.
    fn of(scores: &[Vec<f32>]) -> (f32, Gradients) {
        let mut g = Gaussians::zeroed(scores.len(), scores[0].len(), 0, 0);
        scores.iter().enumerate().for_each(|(i, s)| g.row_mut(Field::ProtoLogits, i).copy_from_slice(s));
        let mut gradients = Gradients::zeroed(&g, 0);
        (aggregation(&g, scores.len() as f32, &mut gradients), gradients)
    }

    #[test]
    fn aggregation_is_zero_for_one_hot_and_0_98421_for_uniform() {
        let mut one_hot = vec![-60.0f32; 32];
        one_hot[7] = 60.0;
        assert!(of(&[one_hot.clone()]).0.abs() < 1e-5);
        let uniform = of(&[vec![0.3; 32]]).0;
        assert!((uniform - 0.98421).abs() < 1e-5, "{uniform}");
        let many: Vec<Vec<f32>> =
            (0..21).map(|i| if i < 4 { vec![0.3; 32] } else { one_hot.clone() }).collect();
        assert!(
            (of(&many).0 - 4.0 * 0.98421).abs() < 1e-4,
            "each Gaussian counts once, in whatever block it is"
        );
    }

    #[test]
    fn aggregation_gradient_agrees_with_central_differences() {
        let scores: Vec<Vec<f32>> =
            (0..18).map(|g| (0..8).map(|i| ((g * 8 + i) as f32 * 1.7).sin()).collect()).collect();
        let gradients = of(&scores).1;
        for (g, i) in [(0, 0), (0, 5), (7, 3), (15, 7), (16, 1), (17, 6)] {
            let (mut hi, mut lo) = (scores[g].clone(), scores[g].clone());
            hi[i] += 1e-2;
            lo[i] -= 1e-2;
            let numeric = (of(&[hi]).0 - of(&[lo]).0) / 2e-2;
            let analytic = gradients.get(Field::ProtoLogits, g)[i];
            assert!((numeric - analytic).abs() < 2e-4, "{g} {i}: {numeric} {analytic}");
        }
    }

    #[test]
    fn nan_scores_do_not_affect_other_gaussians() {
        let fine: Vec<f32> = (0..8).map(|i| (i as f32).cos()).collect();
        let (_, alone) = of(&[fine.clone(), fine.clone()]);
        let (_, beside) = of(&[vec![f32::NAN; 8], fine]);
        assert_eq!(alone.get(Field::ProtoLogits, 1), beside.get(Field::ProtoLogits, 1));
        assert_ne!(alone.get(Field::ProtoLogits, 0), beside.get(Field::ProtoLogits, 0), "the control");
    }
}
