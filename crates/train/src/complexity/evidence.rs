//! Evidence from the state of a training about the model that its scene requires. Pure functions on plain arrays.
//!
//! Every mean is weighted by the contribution of a Gaussian to the photographs (summed blending weight): parts that
//! no photograph shows, such as the inside of an object, are no evidence.

use std::f32::consts::PI;

use relume_engine::softmax;
use relume_scene::light::{LightTables, nrsh};
use relume_scene::{Field, Gaussians, sh_count};

/// Greatest number of visibility coefficients (SH degree 8).
const MAX_COEFFICIENTS: usize = 81;

/// Mean of `(value, weight)` pairs; 0 without weight.
pub fn weighted_mean(pairs: impl Iterator<Item = (f32, f32)>) -> f32 {
    let (sum, weight) = pairs.fold((0.0f64, 0.0f64), |(sum, total), (value, weight)| {
        (sum + f64::from(value) * f64::from(weight), total + f64::from(weight))
    });
    if weight > 0.0 { (sum / weight) as f32 } else { 0.0 }
}

/// Errors of the measured visibility when SH degrees are removed.
#[derive(Debug, Clone, PartialEq)]
pub struct VisibilityErrors {
    /// Mean `|1 - AO|`: without visibility every surface is fully open.
    pub off: f32,
    /// Mean `|AO_l - AO_L|` by kept degree `l`, from 0 to `L`.
    pub ambient: Vec<f32>,
    /// Mean squared error of the field over the sphere by kept degree `l`: `sum_(j beyond l) c_j^2 / 4 pi`
    /// (Parseval).
    pub field: Vec<f32>,
}

/// The direction in which each field of `coefficients` is most open, from its degree 1; +Z without degree 1.
///
/// Early in a training Gaussians are round and their normals arbitrary, but the measured visibility is reliable.
pub fn open_directions(coefficients: &[f32], sh_degree: usize) -> Vec<[f32; 3]> {
    let open = |c: &[f32]| {
        let [x, y, z] = if c.len() >= 4 { [-c[3], -c[1], c[2]] } else { [0.0; 3] };
        let length = (x * x + y * y + z * z).sqrt();
        if length > 1e-6 { [x, y, z].map(|v| v / length) } else { [0.0, 0.0, 1.0] }
    };
    coefficients.chunks_exact(sh_count(sh_degree)).map(open).collect()
}

/// Share of the pixels of a silhouette's convex hull that the silhouette leaves empty; `None` without a silhouette.
///
/// Zero for every image of a convex object at any resolution: no pixel centre lies between the silhouette and its
/// hull.
pub fn concavity(alpha: &[f32], width: usize) -> Option<f32> {
    let mut points: Vec<[i64; 2]> = Vec::new();
    let mut covered = 0usize;
    for (y, row) in alpha.chunks_exact(width.max(1)).enumerate() {
        let inside = |a: &f32| *a > 0.5;
        if let (Some(first), Some(last)) = (row.iter().position(inside), row.iter().rposition(inside)) {
            covered += row.iter().filter(|a| inside(a)).count();
            points.extend([[first as i64, y as i64], [last as i64, y as i64]]);
        }
    }
    let (top, bottom) = (points.first()?[1], points.last()?[1]);
    // The left and right chains of the hull, by monotone chains over rows.
    let chain = |side: i64| {
        let mut chain: Vec<[i64; 2]> = Vec::new();
        for p in points.iter().skip(usize::from(side > 0)).step_by(2) {
            while let [.., a, b] = chain[..]
                && side * ((b[0] - a[0]) * (p[1] - a[1]) - (p[0] - a[0]) * (b[1] - a[1])) <= 0
            {
                chain.pop();
            }
            chain.push(*p);
        }
        chain
    };
    let at = |chain: &[[i64; 2]], y: i64| -> f64 {
        let above = chain.partition_point(|p| p[1] <= y).saturating_sub(1);
        let a = chain[above];
        let b = chain.get(above + 1).copied().unwrap_or(a);
        let share = (y - a[1]) as f64 / (b[1] - a[1]).max(1) as f64;
        a[0] as f64 + share * (b[0] - a[0]) as f64
    };
    let (left, right) = (chain(-1), chain(1));
    let count = |y: i64| ((at(&right, y) + 1e-6).floor() - (at(&left, y) - 1e-6).ceil() + 1.0).max(0.0);
    let hull: f64 = (top..=bottom).map(count).sum();
    Some(((hull - covered as f64) / hull.max(1.0)).max(0.0) as f32)
}

/// Errors when SH degrees of the measurement `coefficients` (`[Gaussian][(sh_degree + 1)^2]`) are removed; ambient
/// occlusion is evaluated along `normals`.
pub fn visibility(
    coefficients: &[f32],
    sh_degree: usize,
    normals: &[[f32; 3]],
    weights: &[f32],
) -> VisibilityErrors {
    let n = sh_count(sh_degree);
    let mut partial = Vec::with_capacity(normals.len());
    let mut beyond = Vec::with_capacity(normals.len());
    for (c, normal) in coefficients.chunks_exact(n).zip(normals) {
        let mut basis = [0.0f32; MAX_COEFFICIENTS];
        nrsh(sh_degree, *normal, &mut basis);
        // Ambient occlusion and energy, degree by degree.
        let (mut ao, mut energy) = ([0.0f32; 9], [0.0f32; 9]);
        for l in 0..=sh_degree {
            let degree = l * l..(l + 1) * (l + 1);
            ao[l] = if l > 0 { ao[l - 1] } else { 0.0 };
            for j in degree {
                ao[l] += c[j] * basis[j];
                energy[l] += c[j] * c[j] / (4.0 * PI);
            }
        }
        partial.push(ao.map(|v| v.clamp(0.0, 1.0)));
        beyond.push(energy);
    }
    let of =
        |value: &dyn Fn(usize) -> f32| weighted_mean(weights.iter().enumerate().map(|(i, w)| (value(i), *w)));
    VisibilityErrors {
        off: of(&|i| 1.0 - partial[i][sh_degree]),
        ambient: (0..=sh_degree).map(|l| of(&|i| (partial[i][l] - partial[i][sh_degree]).abs())).collect(),
        field: (0..=sh_degree).map(|l| of(&|i| beyond[i][l + 1..=sh_degree].iter().sum())).collect(),
    }
}

/// Mean gathered irradiance over mean direct irradiance, summed over the colour channels: the share of bounced light.
pub fn indirect_share(
    gathered: &[[f32; 6]],
    coefficients: &[f32],
    normals: &[[f32; 3]],
    tables: &LightTables,
    weights: &[f32],
) -> f32 {
    let n = coefficients.len() / normals.len().max(1);
    let direct = |i: usize| -> f32 {
        let taps = tables.diffuse_grid.lookup(normals[i]);
        let c = &coefficients[i * n..(i + 1) * n];
        let node = |k: usize| -> f32 {
            let rows = tables.diffuse_rows(taps.node[k]);
            rows.iter().map(|row| row.iter().zip(c).map(|(t, c)| t * c).sum::<f32>()).sum()
        };
        (0..4).map(|k| taps.weight[k] * node(k)).sum::<f32>().max(0.0)
    };
    let mean =
        |value: &dyn Fn(usize) -> f32| weighted_mean(weights.iter().enumerate().map(|(i, w)| (value(i), *w)));
    let bounced = mean(&|i| gathered[i][..3].iter().sum());
    bounced / mean(&direct).max(1e-9)
}

/// Root mean square of the display colour that the radiance branch loses over all directions, by kept degree.
pub fn radiance_residuals(g: &Gaussians, weights: &[f32]) -> Vec<f32> {
    let sh_degree = g.radiance_degree();
    let beyond = |i: usize, degree: usize| -> f32 {
        let rest = &g.row(Field::Radiance, i)[3 * sh_count(degree)..];
        rest.iter().map(|s| s * s).sum::<f32>() / (12.0 * PI)
    };
    let mean = |degree| weighted_mean(weights.iter().enumerate().map(|(i, w)| (beyond(i, degree), *w)));
    (0..=sh_degree).map(|degree| mean(degree).sqrt()).collect()
}

/// Statistics of how the Gaussians mix the prototypes.
#[derive(Debug, Clone, PartialEq)]
pub struct Overlap {
    /// Weighted mean of `p_k p_l`, (K, K).
    products: Vec<f32>,
    masses: Vec<f32>,
}

impl Overlap {
    /// The overlap of the mixtures of `g`.
    pub fn of(g: &Gaussians, weights: &[f32]) -> Self {
        let k = g.prototypes();
        let mut sums = vec![0.0f64; k * k];
        let mut shares = vec![0.0f32; k];
        for (i, weight) in weights.iter().enumerate() {
            softmax(g.row(Field::ProtoLogits, i), &mut shares);
            for (row, p) in sums.chunks_exact_mut(k.max(1)).zip(&shares) {
                row.iter_mut().zip(&shares).for_each(|(sum, q)| *sum += f64::from(p * q * weight));
            }
        }
        let total = sums.iter().sum::<f64>().max(1e-12);
        // The shares of a Gaussian add up to 1, so the products of a row add up to the mass of its prototype.
        let masses = sums.chunks_exact(k.max(1)).map(|row| (row.iter().sum::<f64>() / total) as f32);
        Self { masses: masses.collect(), products: sums.iter().map(|s| (s / total) as f32).collect() }
    }

    /// Share of the photographs' pixels with the colour of prototype `k`.
    pub fn mass(&self, k: usize) -> f32 {
        self.masses[k]
    }

    /// The mass of a group of prototypes.
    pub fn mass_of(&self, group: &[usize]) -> f32 {
        group.iter().map(|k| self.masses[*k]).sum()
    }

    /// The colour of a group: the mean by mass, or the colour of its first member if the mass is 0.
    pub fn mean(&self, colours: &[[f32; 3]], group: &[usize]) -> [f32; 3] {
        let mass = self.mass_of(group);
        if mass <= 1e-9 {
            return colours[group[0]];
        }
        std::array::from_fn(|c| group.iter().map(|k| self.masses[*k] * colours[*k][c]).sum::<f32>() / mass)
    }

    /// Root mean square of the albedo that moves into the residuals if each group becomes one prototype.
    pub fn moved(&self, colours: &[[f32; 3]], groups: &[Vec<usize>]) -> f32 {
        let mut shift = vec![[0.0f32; 3]; colours.len()];
        for group in groups {
            let mean = self.mean(colours, group);
            group.iter().for_each(|k| shift[*k] = std::array::from_fn(|c| colours[*k][c] - mean[c]));
        }
        let rows = self.products.chunks_exact(colours.len().max(1)).zip(&shift);
        let along = |a: &[f32; 3], b: &[f32; 3]| (0..3).map(|c| f64::from(a[c] * b[c])).sum::<f64>();
        let squares = rows.map(|(row, a)| -> f64 {
            row.iter().zip(&shift).map(|(p, b)| f64::from(*p) * along(a, b)).sum()
        });
        (squares.sum::<f64>().max(0.0) / 3.0).sqrt() as f32
    }
}

/// Coefficients of a field that is open only on the side of `normal`.
#[cfg(test)]
pub(super) fn half_open(sh_degree: usize, normal: [f32; 3]) -> Vec<f32> {
    let directions = relume_engine::fibonacci_sphere(4096);
    let mut out = vec![0.0; sh_count(sh_degree)];
    for d in directions.iter().filter(|d| (0..3).map(|k| d[k] * normal[k]).sum::<f32>() > 0.0) {
        let mut y = [0.0f32; MAX_COEFFICIENTS];
        relume_scene::light::sh_eval(sh_degree, *d, &mut y);
        out.iter_mut().zip(&y).for_each(|(o, y)| *o += 4.0 * PI / 4096.0 * y);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use relume_scene::light::{EnvOperators, TableResolution, UNOCCLUDED_SH0};

    #[test]
    fn visibility_errors_match_the_analytic_half_sky_energy() {
        let up = [0.0, 0.0, 1.0];
        let errors = visibility(&half_open(4, up), 4, &[up], &[2.0]);
        assert!(errors.off < 0.01, "open in its whole hemisphere: {errors:?}");
        // Half the sphere: its degree-1 coefficient is sqrt(3 pi) / 2, its degree-3 coefficient -sqrt(7 pi) / 8.
        let [one, three] = [3.0 / 16.0, 7.0 / 256.0];
        for (l, expected) in [one + three, three, three, 0.0, 0.0].into_iter().enumerate() {
            assert!((errors.field[l] - expected).abs() < 2e-3, "{l}: {errors:?}");
        }
        assert!((errors.ambient[0] - 0.5).abs() < 0.01 && errors.ambient[1] < 0.01, "{errors:?}");
        let wall = half_open(4, [1.0, 0.0, 0.0]);
        let beside = visibility(&wall, 4, &[up], &[1.0]);
        assert!(
            (beside.off - 0.5).abs() < 0.02,
            "the control: a wall blocks half of its hemisphere: {beside:?}"
        );
        let both: Vec<f32> = half_open(4, up).into_iter().chain(wall).collect();
        let unseen = visibility(&both, 4, &[up, up], &[1.0, 0.0]);
        assert!(unseen.off < 0.01, "invisible Gaussians do not count: {unseen:?}");
    }

    #[test]
    fn concavity_is_zero_only_for_convex_silhouettes() {
        let picture = |inside: &dyn Fn(i32, i32) -> bool| -> Vec<f32> {
            (0..32 * 32).map(|i| f32::from(u8::from(inside(i % 32, i / 32)))).collect()
        };
        let disc = picture(&|x, y| (x - 15).pow(2) + (y - 14).pow(2) <= 110);
        assert_eq!(concavity(&disc, 32), Some(0.0));
        let tilted = picture(&|x, y| (x - 16).abs() * 2 + (y - 16).abs() * 3 <= 30);
        assert_eq!(concavity(&tilted, 32), Some(0.0));
        // Three of the four 8 x 8 fields of a square; its hull cuts the corner of the fourth: 28 of 220 pixels are empty.
        let corner = picture(&|x, y| (8..24).contains(&x) && (8..24).contains(&y) && !(x >= 16 && y < 16));
        let empty = concavity(&corner, 32).unwrap();
        assert!((empty - 28.0 / 220.0).abs() < 0.03, "{empty}");
        let two = picture(&|x, y| (4..28).contains(&y) && ((2..8).contains(&x) || (24..30).contains(&x)));
        assert!((concavity(&two, 32).unwrap() - 16.0 / 28.0).abs() < 1e-6, "a gap inside a row counts");
        assert_eq!(concavity(&[0.0; 64], 8), None);
    }

    #[test]
    fn open_direction_of_a_half_open_field_is_its_axis() {
        let side = [0.6, 0.0, 0.8];
        let found = open_directions(&half_open(4, side), 4)[0];
        assert!((0..3).all(|k| (found[k] - side[k]).abs() < 0.01), "{found:?}");
    }

    #[test]
    fn indirect_share_is_the_ratio_of_irradiances() {
        let operators = EnvOperators::new(16, 8, 1, TableResolution::TRAINING);
        let tables = operators.apply(&[[1.0; 3]; 128]);
        let open = [UNOCCLUDED_SH0, 0.0, 0.0, 0.0];
        let up = [[0.0, 0.0, 1.0]];
        let gathered = [[0.1 * PI, 0.1 * PI, 0.1 * PI, 9.0, 9.0, 9.0]];
        // An open surface under white light of radiance 1 receives pi.
        let share = indirect_share(&gathered, &open, &up, &tables, &[3.0]);
        assert!((share - 0.1).abs() < 2e-3, "{share}");
        assert_eq!(indirect_share(&[[0.0; 6]], &open, &up, &tables, &[3.0]), 0.0);
    }

    #[test]
    fn radiance_residual_is_the_energy_of_removed_degrees() {
        let mut g = Gaussians::zeroed(2, 1, 0, 1);
        g.row_mut(Field::Radiance, 0)[3..].fill(0.2);
        let expected = (9.0f32 * 0.04 / (12.0 * PI)).sqrt();
        let residuals = radiance_residuals(&g, &[1.0, 0.0]);
        assert!((residuals[0] - expected).abs() < 1e-6 && residuals[1] == 0.0, "{residuals:?}");
        assert_eq!(
            radiance_residuals(&g, &[0.0, 1.0])[0],
            0.0,
            "the control: the other Gaussian does not depend on direction"
        );
    }

    #[test]
    fn prototype_mass_is_its_weighted_share_of_gaussians() {
        let mut g = Gaussians::zeroed(2, 2, 0, 0);
        g.row_mut(Field::ProtoLogits, 0).copy_from_slice(&[0.0, 3f32.ln()]);
        g.row_mut(Field::ProtoLogits, 1).copy_from_slice(&[20.0, 0.0]);
        let overlap = Overlap::of(&g, &[3.0, 1.0]);
        let masses = [overlap.mass(0), overlap.mass(1)];
        // (3 / 4 + 1) / 4 and the rest.
        assert!((masses[0] - 1.75 / 4.0).abs() < 1e-5 && (masses[1] - 2.25 / 4.0).abs() < 1e-5, "{masses:?}");
        assert!(Overlap::of(&g, &[0.0, 1.0]).mass(1) < 1e-6);
        // Merged, the mean is 0.3 + 0.4 x 2.25 / 4; the albedos were 0.6 and 0.3.
        let moved = overlap.moved(&[[0.3; 3], [0.7; 3]], &[vec![0, 1]]);
        let mean = 0.3 + 0.4 * 2.25 / 4.0;
        let expected = (0.75 * (0.6f32 - mean).powi(2) + 0.25 * (0.3 - mean).powi(2)).sqrt();
        assert!((moved - expected).abs() < 1e-5, "{moved} {expected}");
    }
}
