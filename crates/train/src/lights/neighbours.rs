//! Pairs of neighbouring Gaussians.

use std::collections::HashMap;

use relume_scene::{Field, Gaussians};

/// Number of neighbours with which each Gaussian is compared.
const NEIGHBOUR_COUNT: usize = 6;
/// Rounds of smoothing. The colour of a pixel comes from several Gaussians, so the colour of a single Gaussian is
/// unreliable.
const ROUNDS: usize = 2;

/// Gaussians that have neighbours, the members, and pairs of them and their nearest neighbours. Values of members are in the order of
/// their indices.
#[derive(Debug, Clone, PartialEq)]
pub struct Neighbours {
    /// Indices of the Gaussians, ascending.
    members: Vec<u32>,
    /// Two places in `members` and the smaller of their weights.
    pairs: Vec<(u32, u32, f32)>,
    /// Sum of the pairs' weights.
    total: f64,
    /// Weight of each member.
    weights: Vec<f32>,
}

impl Neighbours {
    /// Pairs among the Gaussians `used`; `weights` of all Gaussians.
    pub fn of(g: &Gaussians, used: &[u32], weights: &[f32]) -> Self {
        let mean = |i: u32| -> [f32; 3] { g.get(Field::Mean, i as usize) };
        // Cells that contain a few Gaussians each if these lie on surfaces.
        let cell = 3.0 / (used.len().max(1) as f32).sqrt();
        let key = |p: [f32; 3]| p.map(|v| (v / cell).floor().clamp(-1e6, 1e6) as i32);
        let mut cells: HashMap<[i32; 3], Vec<u32>> = HashMap::new();
        used.iter().for_each(|&i| cells.entry(key(mean(i))).or_default().push(i));
        let mut pairs = Vec::new();
        for &i in used {
            let (at, k) = (mean(i), key(mean(i)));
            let mut near: Vec<(f32, u32)> = Vec::new();
            for offset in 0..27 {
                let cell = [k[0] + offset % 3 - 1, k[1] + offset / 3 % 3 - 1, k[2] + offset / 9 - 1];
                let others = cells.get(&cell).into_iter().flatten().filter(|j| **j != i);
                near.extend(others.map(|j| (square_distance(at, mean(*j)), *j)));
            }
            near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let weight = |j: u32| weights[i as usize].min(weights[j as usize]);
            pairs.extend(near.iter().take(NEIGHBOUR_COUNT).map(|(_, j)| (i, *j, weight(*j))));
        }
        let total = pairs.iter().map(|(_, _, w)| f64::from(*w)).sum::<f64>().max(1e-12);
        let mut members: Vec<u32> = pairs.iter().flat_map(|(i, j, _)| [*i, *j]).collect();
        members.sort_unstable();
        members.dedup();
        let mut place = vec![0u32; weights.len()];
        members.iter().zip(0..).for_each(|(i, k)| place[*i as usize] = k);
        pairs.iter_mut().for_each(|(i, j, _)| (*i, *j) = (place[*i as usize], place[*j as usize]));
        let weights = members.iter().map(|i| weights[*i as usize]).collect();
        Self { members, pairs, total, weights }
    }

    /// The pairs: two places among the members and the smaller of their weights.
    pub fn pairs(&self) -> &[(u32, u32, f32)] {
        &self.pairs
    }

    /// The indices of the members, ascending.
    pub fn members(&self) -> &[u32] {
        &self.members
    }

    /// The values of the members.
    pub fn of_members<T: Copy>(&self, values: &[T]) -> Vec<T> {
        self.members.iter().map(|i| values[*i as usize]).collect()
    }

    /// Replaces values of the members by weighted means with those of their neighbours.
    pub fn smooth<const N: usize>(&self, values: &mut [[f32; N]]) {
        for _ in 0..ROUNDS {
            let own = values.iter().zip(&self.weights).map(|(v, w)| (v.map(|v| v * w), *w));
            let mut sums: Vec<([f32; N], f32)> = own.collect();
            for (i, j, _) in &self.pairs {
                let (w, other) = (self.weights[*j as usize], values[*j as usize]);
                let (sum, weight) = &mut sums[*i as usize];
                (0..N).for_each(|c| sum[c] += w * other[c]);
                *weight += w;
            }
            for (v, (sum, weight)) in values.iter_mut().zip(sums) {
                if weight > 0.0 {
                    *v = sum.map(|s| s / weight);
                }
            }
        }
    }

    /// Weighted mean absolute differences of values of the members between neighbours, one per column.
    pub fn variations<const N: usize>(&self, values: &[[f32; N]]) -> [f32; N] {
        let mut sums = [0.0f64; N];
        for (i, j, w) in &self.pairs {
            let (a, b) = (&values[*i as usize], &values[*j as usize]);
            for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
                *sum += f64::from(w * (a - b).abs());
            }
        }
        sums.map(|sum| (sum / self.total) as f32)
    }
}

fn square_distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row of Gaussians 0.1 apart.
    fn row(n: usize) -> Gaussians {
        let mut g = Gaussians::zeroed(n, 1, 0, 0);
        (0..n).for_each(|i| g.row_mut(Field::Mean, i)[0] = 0.1 * i as f32);
        g
    }

    #[test]
    fn variation_is_proportional_to_the_number_of_edges() {
        let g = row(60);
        let used: Vec<u32> = (0..60).collect();
        let pairs = Neighbours::of(&g, &used, &[1.0; 60]);
        let columns = |i: i32| [0.7, f32::from(i >= 30), f32::from((20..40).contains(&i))];
        let [even, step, two] = pairs.variations(&(0..60).map(columns).collect::<Vec<_>>());
        assert_eq!(even, 0.0);
        assert!(step > 0.0);
        assert!((two / step - 2.0).abs() < 0.2);
    }

    #[test]
    fn smoothing_keeps_uniform_values_of_the_members() {
        let g = row(20);
        let pairs = Neighbours::of(&g, &(0..19).collect::<Vec<_>>(), &[1.0; 20]);
        let all: Vec<[f32; 1]> = (0..20).map(|i| [if i == 19 { 5.0 } else { 1.0 }]).collect();
        let mut values = pairs.of_members(&all);
        assert_eq!(pairs.members(), (0..19).collect::<Vec<u32>>(), "without the unused Gaussian");
        pairs.smooth(&mut values);
        assert!(values.iter().all(|v| (v[0] - 1.0).abs() < 1e-6));
        let mut noise: Vec<[f32; 1]> = (0..19).map(|i| [(i % 2) as f32]).collect();
        pairs.smooth(&mut noise);
        assert!(noise[5..15].iter().all(|v| (v[0] - 0.5).abs() < 0.2), "{noise:?}");
    }
}
