//! Decisions: pure functions from evidence to the smallest model within stated tolerances.

use std::fmt;

use crate::complexity::evidence::{Overlap, VisibilityErrors};

/// Share of its convex hull that the silhouette of a convex object may leave empty, mean over the photographs.
pub const CONVEX_TOLERANCE: f32 = 0.01;
/// Largest mean change of ambient occlusion (0 to 1) when visibility is removed. It detects concavities that
/// silhouettes do not show, such as a bowl, whose inside sees half of the sky. It is above the measurement error
/// halfway through a training: 0.04 to 0.09 on a matte ball, 0.14 on a mirror, whose reflection is made of Gaussians
/// inside it.
pub const OFF_TOLERANCE: f32 = 0.18;
/// Largest mean change of ambient occlusion when SH degrees are removed.
pub const AMBIENT_TOLERANCE: f32 = 0.005;
/// Largest mean squared error of the field (0 to 1) when SH degrees are removed.
pub const FIELD_TOLERANCE: f32 = 0.005;
/// Ratio of bounced to direct irradiance up to which bounced light is removed.
pub const INDIRECT_TOLERANCE: f32 = 0.01;
/// Largest loss of display colour in the radiance branch, root mean square.
pub const RADIANCE_TOLERANCE: f32 = 0.01;
/// Largest immediate loss of training PSNR when all surfaces become dielectric, dB.
pub const METALNESS_TOLERANCE: f32 = 0.03;
/// Largest loss of training PSNR when sheen is removed at the end, dB.
pub const SHEEN_TOLERANCE: f32 = 0.05;
/// Largest linear albedo that merging prototypes may move into the residuals, root mean square.
pub const PROTOTYPE_TOLERANCE: f32 = 0.03;
/// Largest immediate loss of training PSNR when Gaussians are dropped, dB.
pub const DROP_TOLERANCE: f32 = 0.02;
/// Shares of the Gaussians, those of least weight, that are dropped in successive trials.
pub const DROPPED_SHARES: [f32; 12] = [0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.6, 0.7];
/// Gain of training PSNR during a doubling of the Gaussians below which no more are added, dB.
pub const MIN_PSNR_GAIN: f32 = 0.2;
/// Training PSNR above which no more Gaussians are added, dB: a root mean square error of 1.4 / 255.
pub const SUFFICIENT_PSNR: f32 = 45.0;

/// The visibility field that a scene requires.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RequiredVisibility {
    /// None: every surface sees all directions in its hemisphere.
    Off,
    /// SH degrees up to this one.
    Degree(usize),
}

impl fmt::Display for RequiredVisibility {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => f.write_str("off"),
            Self::Degree(sh_degree) => write!(f, "degree {sh_degree}"),
        }
    }
}

/// Knowledge about the shape of a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Convexity {
    /// The scene is convex: no surface blocks the sky for another.
    Convex,
    /// The scene is not convex, or there is no evidence that it is.
    Unproven,
}

/// The convexity from silhouettes (`concavity`, `None` without masks) and from measured visibility (`off`, the mean
/// change of ambient occlusion without visibility).
pub fn convexity(concavity: Option<f32>, off: f32) -> Convexity {
    let is_convex = concavity.is_some_and(|c| c <= CONVEX_TOLERANCE) && off <= OFF_TOLERANCE;
    if is_convex { Convexity::Convex } else { Convexity::Unproven }
}

/// The least visibility within tolerance; none for a convex object, unless gathered light is kept.
///
/// Never degree 0 if the configured degree is higher: degree 1 contains the open side of a surface.
pub fn visibility(errors: &VisibilityErrors, convexity: Convexity, is_gathered: bool) -> RequiredVisibility {
    if convexity == Convexity::Convex && !is_gathered {
        return RequiredVisibility::Off;
    }
    let sh_degree = errors.field.len() - 1;
    let fits = |l: &usize| errors.ambient[*l] <= AMBIENT_TOLERANCE && errors.field[*l] <= FIELD_TOLERANCE;
    RequiredVisibility::Degree((1..sh_degree).find(fits).unwrap_or(sh_degree))
}

/// The indices of the Gaussians that remain when `share` of them, those of least weight, are dropped: ascending, at
/// least one.
pub fn heaviest(weights: &[f32], share: f32) -> Vec<usize> {
    let mut by_weight: Vec<usize> = (0..weights.len()).collect();
    by_weight.sort_unstable_by(|a, b| weights[*a].total_cmp(&weights[*b]).then(b.cmp(a)));
    let dropped = ((share * weights.len() as f32) as usize).min(weights.len().saturating_sub(1));
    let mut left = by_weight.split_off(dropped);
    left.sort_unstable();
    left
}

/// The least degree of the radiance branch whose loss is within tolerance.
///
/// Never degree 0 if the configured degree is higher: degree 1 takes the direction-dependent part of the colour, and
/// albedo restarts from the rest.
pub fn radiance_degree(residuals: &[f32]) -> usize {
    let most = residuals.len().saturating_sub(1);
    residuals.iter().position(|r| *r <= RADIANCE_TOLERANCE).unwrap_or(most).max(1).min(most)
}

/// Groups of prototypes to merge, the heaviest member first. Each round makes the cheapest merge while the albedo
/// that moves into the residuals (root mean square, the second value) is within tolerance.
///
/// The cost considers the mixtures of the Gaussians, not only the distance of the prototypes' colours: all Gaussians
/// may mix two distant colours in the same proportion, and a prototype may have no weight at all.
pub fn prototypes(colours: &[[f32; 3]], overlap: &Overlap) -> (Vec<Vec<usize>>, f32) {
    let shown: Vec<[f32; 3]> = colours.iter().map(|c| c.map(|v| v.clamp(0.0, 1.0))).collect();
    let mut groups: Vec<Vec<usize>> = (0..shown.len()).map(|k| vec![k]).collect();
    let mut moved = 0.0;
    while let Some((a, b)) = cheapest_merge(&shown, &groups, overlap) {
        let mut merged = groups.clone();
        let second = merged.remove(b);
        merged[a].extend(second);
        let cost = overlap.moved(&shown, &merged);
        if cost > PROTOTYPE_TOLERANCE {
            break;
        }
        (groups, moved) = (merged, cost);
    }
    let heavier = |a: &usize, b: &usize| overlap.mass(*b).total_cmp(&overlap.mass(*a)).then(a.cmp(b));
    groups.iter_mut().for_each(|group| group.sort_by(heavier));
    groups.sort_by(|a, b| heavier(&a[0], &b[0]));
    (groups, moved)
}

/// The two groups, in order, with the nearest means, weighted as in Ward's method: the cost of a merge if no Gaussian
/// mixes the two.
fn cheapest_merge(colours: &[[f32; 3]], groups: &[Vec<usize>], overlap: &Overlap) -> Option<(usize, usize)> {
    let of: Vec<_> = groups.iter().map(|g| (overlap.mean(colours, g), overlap.mass_of(g))).collect();
    let cost = |(a, b): &(usize, usize)| {
        let (([p, q], [m, n]), sum) = (([of[*a].0, of[*b].0], [of[*a].1, of[*b].1]), of[*a].1 + of[*b].1);
        m * n / sum.max(1e-12) * (0..3).map(|c| (p[c] - q[c]).powi(2)).sum::<f32>()
    };
    let pairs = (0..groups.len()).flat_map(|a| (a + 1..groups.len()).map(move |b| (a, b)));
    pairs.min_by(|x, y| cost(x).total_cmp(&cost(y)))
}

/// A round of density control: the number of Gaussians before it, and the mean training PSNR since the round before, dB.
pub type Round = (u32, f32);

/// The two rounds that show that more Gaussians no longer improve the result, if there are such rounds: a doubling of the
/// Gaussians gained less than [`MIN_PSNR_GAIN`], or the PSNR is above [`SUFFICIENT_PSNR`].
///
/// The gain includes that of the steps during the doubling. The gain of a single round tells nothing: it is smaller than
/// the difference between the photographs of two rounds, and new Gaussians must train first. The criterion must hold for
/// two consecutive rounds, because the PSNR of one round is a mean over only some photographs.
pub fn end_of_growth(history: &[Round]) -> Option<[Round; 2]> {
    let [before @ .., a, b] = history else { return None };
    if a.1 > SUFFICIENT_PSNR && b.1 > SUFFICIENT_PSNR {
        return Some([*a, *b]);
    }
    let flat_since = |to: &Round| {
        let from = before.iter().rev().find(|from| 2 * from.0.max(1) <= to.0)?;
        let doublings = (to.0 as f32 / from.0.max(1) as f32).log2();
        (to.1 - from.1 < MIN_PSNR_GAIN * doublings).then_some(*from)
    };
    flat_since(a)?;
    Some([flat_since(b)?, *b])
}

#[cfg(test)]
mod tests {
    use super::Convexity::{Convex, Unproven};
    use super::*;

    fn errors(off: f32, ambient: [f32; 5], field: [f32; 5]) -> VisibilityErrors {
        VisibilityErrors { off, ambient: ambient.into(), field: field.into() }
    }

    #[test]
    fn lowest_visibility_within_both_tolerances_is_chosen() {
        let flat = [0.0; 5];
        assert_eq!(visibility(&errors(0.01, flat, flat), Convex, false), RequiredVisibility::Off);
        assert_eq!(visibility(&errors(0.01, flat, flat), Convex, true), RequiredVisibility::Degree(1));
        assert_eq!(visibility(&errors(0.01, flat, flat), Unproven, false), RequiredVisibility::Degree(1));
        assert_eq!(convexity(Some(0.0), 0.05), Convex);
        assert_eq!(convexity(Some(0.0), 0.3), Unproven, "a bowl looks convex from outside");
        assert_eq!([convexity(Some(0.2), 0.0), convexity(None, 0.0)], [Unproven; 2], "no masks, no evidence");
        let needs_two = [0.5, 0.1, 0.001, 0.0, 0.0];
        assert_eq!(visibility(&errors(0.2, needs_two, flat), Unproven, false), RequiredVisibility::Degree(2));
        assert_eq!(visibility(&errors(0.2, flat, needs_two), Unproven, false), RequiredVisibility::Degree(2));
        let needs_all = [0.5, 0.4, 0.3, 0.2, 0.0];
        assert_eq!(visibility(&errors(0.2, flat, needs_all), Unproven, false), RequiredVisibility::Degree(4));
    }

    /// Mixtures of Gaussians with equal weight.
    fn mixed<const K: usize>(shares: &[[f32; K]]) -> Overlap {
        let mut g = relume_scene::Gaussians::zeroed(shares.len(), K, 0, 0);
        for (i, shares) in shares.iter().enumerate() {
            let row = g.row_mut(relume_scene::Field::ProtoLogits, i);
            row.iter_mut().zip(shares).for_each(|(score, p)| *score = p.max(1e-9).ln());
        }
        Overlap::of(&g, &vec![1.0; shares.len()])
    }

    #[test]
    fn similar_prototypes_merge_and_unused_ones_are_absorbed() {
        let colours = [[0.5; 3], [0.52; 3], [0.9; 3], [0.1; 3]];
        let pure = mixed(&[[0.4, 0.6, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
        let (groups, moved) = prototypes(&colours, &pure);
        assert_eq!(groups, [vec![1, 0, 3], vec![2]]);
        assert!(moved > 0.0 && moved < 0.01, "{moved}");
        let (apart, moved) = prototypes(&colours[2..], &mixed(&[[1.0, 0.0], [0.0, 1.0]]));
        assert_eq!((apart, moved), (vec![vec![0], vec![1]], 0.0), "the control: far apart and used");
        assert_eq!(prototypes(&colours[..1], &mixed(&[[1.0]])).0, [vec![0]], "at least one stays");
        assert_eq!(prototypes(&[], &mixed::<0>(&[])).0, Vec::<Vec<usize>>::new());
    }

    #[test]
    fn prototypes_that_all_surfaces_mix_equally_are_merged() {
        let colours = [[0.2; 3], [0.8; 3]];
        assert_eq!(prototypes(&colours, &mixed(&[[0.5, 0.5], [0.49, 0.51]])).0.len(), 1);
        assert_eq!(prototypes(&colours, &mixed(&[[0.7, 0.3], [0.3, 0.7]])).0.len(), 2, "the control");
    }

    #[test]
    fn growth_ends_after_a_flat_doubling_or_at_the_highest_psnr() {
        let doubled =
            |last: [f32; 2]| end_of_growth(&[(1000, 30.0), (1400, 30.0), (2000, last[0]), (2100, last[1])]);
        assert_eq!(doubled([30.1, 30.1]), Some([(1000, 30.0), (2100, 30.1)]));
        assert_eq!([doubled([30.3, 30.1]), doubled([30.1, 30.3])], [None; 2], "one flat round is not enough");
        assert_eq!(doubled([30.1, f32::NAN]), None, "a PSNR that is not a number proves nothing");
        let short = [(1000, 30.0), (1400, 29.9), (1800, 29.8), (1990, 29.7)];
        assert_eq!(end_of_growth(&short), None, "the Gaussians have not doubled");
        let high = [(1000, 44.5), (1200, 45.5), (1400, 46.5)];
        assert_eq!(end_of_growth(&high), Some([high[1], high[2]]));
        assert_eq!([end_of_growth(&[(1200, 30.0), (1400, 30.0)]), end_of_growth(&[])], [None; 2]);
    }

    #[test]
    fn least_contributing_gaussians_are_dropped_but_never_all() {
        let weights = [0.5, 0.0, 3.0, 0.0, 1.0];
        assert_eq!(heaviest(&weights, 0.0), [0, 1, 2, 3, 4]);
        assert_eq!(heaviest(&weights, 0.2), [0, 1, 2, 4], "of equal weights the later one");
        assert_eq!(heaviest(&weights, 0.7), [2, 4]);
        assert_eq!(heaviest(&weights, 1.0), [2]);
        assert!(heaviest(&[], 0.5).is_empty());
    }

    #[test]
    fn radiance_degree_keeps_only_significant_coefficients() {
        assert_eq!(radiance_degree(&[0.005, 0.001, 0.0]), 1);
        assert_eq!(radiance_degree(&[0.0]), 0, "the degree cannot increase");
        assert_eq!(radiance_degree(&[0.05, 0.004, 0.0]), 1);
        assert_eq!(radiance_degree(&[0.05, 0.04, 0.0]), 2);
    }
}
