//! Differences of the logarithms of albedo between neighbours.

use crate::lights::{LightSearch, MIN_LOG_ARGUMENT};

/// Colours of points with their neighbours, and the light that the points gather from others.
pub(super) struct Variation {
    /// Logarithms of linear colours.
    colours: Vec<[f32; 3]>,
    /// Irradiance from blocked directions, which does not scale with the unknown light.
    gathered: Vec<[f32; 3]>,
    /// Number of pixels in which each point is visible.
    pub(super) pixels: Vec<f32>,
    /// Two points and the share of their weight.
    pairs: Vec<(u32, u32, f32)>,
}

impl Variation {
    /// The variation among the members of `search`. `gathered`: light that each Gaussian receives from other surfaces. `seen`: number of pixels in which each Gaussian is visible.
    pub(super) fn of(search: &LightSearch<'_>, gathered: &[[f32; 6]], seen: &[f32]) -> Self {
        let neighbours = &search.neighbours;
        let of_sky = |i: &u32| gathered.get(*i as usize).map_or([0.0; 3], |[r, g, b, ..]| [*r, *g, *b]);
        let mut gathered: Vec<[f32; 3]> = neighbours.members().iter().map(of_sky).collect();
        neighbours.smooth(&mut gathered);
        let pairs = neighbours.pairs();
        let total: f32 = pairs.iter().map(|(_, _, weight)| weight).sum();
        let pair = |(i, j, weight): &(u32, u32, f32)| (*i, *j, weight / total.max(f32::MIN_POSITIVE));
        Self {
            colours: search.colours.clone(),
            gathered,
            pixels: neighbours.of_members(seen),
            pairs: pairs.iter().map(pair).collect(),
        }
    }

    /// Derivative by the irradiance from the unknown light, `direct`, of `sum_ij w_ij ln(1 + |x_i - x_j|^2 / (3 scale^2))`, where `x` is the
    /// logarithm of colour over irradiance. A difference far above `scale` counts little: it is an edge of the material.
    pub(super) fn gradient(&self, direct: &[[f32; 3]], scale: f32) -> Vec<[f32; 3]> {
        let irradiance = |(direct, gathered): (&[f32; 3], &[f32; 3])| -> [f32; 3] {
            std::array::from_fn(|c| (direct[c] + gathered[c]).max(MIN_LOG_ARGUMENT))
        };
        let irradiance: Vec<[f32; 3]> = direct.iter().zip(&self.gathered).map(irradiance).collect();
        let albedo = |(colour, e): (&[f32; 3], &[f32; 3])| -> [f32; 3] {
            std::array::from_fn(|c| colour[c] - e[c].ln())
        };
        let albedo: Vec<[f32; 3]> = self.colours.iter().zip(&irradiance).map(albedo).collect();
        let mut by_albedo = vec![[0.0f32; 3]; albedo.len()];
        for (i, j, weight) in &self.pairs {
            let (i, j) = (*i as usize, *j as usize);
            let difference: [f32; 3] = std::array::from_fn(|c| albedo[i][c] - albedo[j][c]);
            let square = difference.iter().map(|d| d * d).sum::<f32>() / (3.0 * scale * scale);
            for c in 0..3 {
                let slope = weight * difference[c] / (scale * scale * (1.0 + square));
                by_albedo[i][c] += slope;
                by_albedo[j][c] -= slope;
            }
        }
        let by_light = by_albedo.iter().zip(&irradiance);
        by_light.map(|(slope, e)| std::array::from_fn(|c| -slope[c] / e[c])).collect()
    }
}
