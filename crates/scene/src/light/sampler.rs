//! Monte-Carlo integration under an environment. Directions are drawn by the light, by the cosine and by the lobe, and
//! weighted by the combined density of all three (the balance heuristic): where one density samples poorly, another samples
//! well.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use rand::{Rng, RngExt as _};

use crate::light::{Reflected, Reflector};
use crate::{EnvMap, direction_to_uv};

/// An environment of constant texels, from which directions are drawn in proportion to brightness.
#[derive(Debug, Clone)]
pub struct EnvSampler {
    map: EnvMap,
    /// Cumulative integral of brightness over rows; the last entry is the total.
    rows: Vec<f64>,
    /// Cumulative sum of brightness over the columns of each row.
    columns: Vec<f64>,
}

/// An [`EnvSampler`] in f32.
#[derive(Debug, Clone, PartialEq)]
pub struct SamplerTables {
    /// Columns of the map.
    pub width: usize,
    /// Rows of the map.
    pub height: usize,
    /// Radiance RGB, and the density of drawing a direction in the texel, per steradian.
    pub texels: Vec<[f32; 4]>,
    /// Cumulative shares of the light: over rows, then over the columns of each row.
    pub sums: Vec<f32>,
}

/// Mean of the channels: zero only where every channel is zero.
fn brightness(texel: [f32; 3]) -> f64 {
    texel.iter().map(|v| f64::from(*v)).sum::<f64>() / 3.0
}

impl EnvSampler {
    /// A sampler of `map`.
    pub fn new(map: EnvMap) -> Self {
        let (mut rows, mut columns) = (Vec::with_capacity(map.height()), Vec::new());
        let mut total = 0.0;
        for (y, row) in map.texels().chunks_exact(map.width()).enumerate() {
            let mut along = 0.0;
            columns.extend(row.iter().map(|t| {
                along += brightness(*t);
                along
            }));
            total += along * texel_area(&map, y);
            rows.push(total);
        }
        Self { map, rows, columns }
    }

    fn total(&self) -> f64 {
        self.rows.last().copied().unwrap_or(0.0)
    }

    /// The sampler in f32, for engines that draw directions themselves.
    pub fn tables(&self) -> SamplerTables {
        let (width, height, total) = (self.map.width(), self.map.height(), self.total());
        let share = |sum: f64, of: f64| if of > 0.0 { (sum / of) as f32 } else { 0.0 };
        let mut sums: Vec<f32> = self.rows.iter().map(|sum| share(*sum, total)).collect();
        for row in self.columns.chunks_exact(width) {
            let all = row.last().copied().unwrap_or(0.0);
            sums.extend(row.iter().map(|sum| share(*sum, all)));
        }
        let texel = |t: &[f32; 3]| [t[0], t[1], t[2], share(brightness(*t), total)];
        SamplerTables { width, height, texels: self.map.texels().iter().map(texel).collect(), sums }
    }

    /// True when there is no light to draw from.
    pub fn is_dark(&self) -> bool {
        !(self.total() > 0.0)
    }

    /// A direction from two numbers in [0, 1).
    pub fn sample(&self, u: [f64; 2]) -> DVec3 {
        let (w, h) = (self.map.width(), self.map.height());
        let (y, down) = pick(&self.rows, u[0]);
        let (x, along) = pick(&self.columns[y * w..(y + 1) * w], u[1]);
        let edge = |y: usize| (PI * y as f64 / h as f64).cos();
        let z = edge(y) + (edge(y + 1) - edge(y)) * down;
        let sin = (1.0 - z * z).max(0.0).sqrt();
        let phi = (0.5 - (x as f64 + along) / w as f64) * TAU;
        DVec3::new(sin * phi.cos(), sin * phi.sin(), z)
    }

    /// Radiance from unit `d`, and the density of [`Self::sample`] there per steradian.
    pub fn at(&self, d: DVec3) -> ([f64; 3], f64) {
        let [u, v] = direction_to_uv(d);
        let cell = |x: f64, n: usize| ((x * n as f64) as usize).min(n - 1);
        let (x, y) = (cell(u, self.map.width()), cell(v, self.map.height()));
        let texel = self.map.texels()[y * self.map.width() + x];
        let density = if self.is_dark() { 0.0 } else { brightness(texel) / self.total() };
        (texel.map(f64::from), density)
    }
}

/// Solid angle of a texel of row `y`.
fn texel_area(map: &EnvMap, y: usize) -> f64 {
    let edge = |y: usize| (PI * y as f64 / map.height() as f64).cos();
    (edge(y) - edge(y + 1)) * TAU / map.width() as f64
}

/// The cell of a cumulative sum that contains the fraction `u` of its total, and the position within the cell, 0 to 1.
fn pick(sums: &[f64], u: f64) -> (usize, f64) {
    let target = u * sums.last().copied().unwrap_or(0.0);
    let i = sums.partition_point(|s| *s <= target).min(sums.len() - 1);
    let before = if i > 0 { sums[i - 1] } else { 0.0 };
    let inside = (target - before) / (sums[i] - before).max(1e-300);
    (i, inside.clamp(0.0, 1.0))
}

/// Number of samples of each density. The estimate's mean does not depend on them provided the lobe, whose directions cover
/// the whole half sphere, gets at least one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SampleCounts {
    /// Samples drawn by the environment's brightness.
    pub light: u32,
    /// Samples drawn by the cosine.
    pub cosine: u32,
    /// Samples drawn by the lobe of half vectors.
    pub lobe: u32,
}

impl SampleCounts {
    /// Half of `samples` by the light, a quarter each by cosine and lobe. Under a dark environment the cosine gets the
    /// light's samples.
    pub fn of(samples: u32, light: &EnvSampler) -> Self {
        let lobe = samples.div_ceil(4);
        let by_light = if light.is_dark() { 0 } else { samples / 2 };
        Self { light: by_light, cosine: samples - lobe - by_light, lobe }
    }
}

/// Estimates the light that `surface` reflects to the camera. `transmittance` attenuates `environment` per direction; the
/// specular part sees `blocked` in the hidden share.
pub fn estimate(
    surface: &Reflector,
    environment: &EnvSampler,
    blocked: [f64; 3],
    counts: SampleCounts,
    random: &mut impl Rng,
    mut transmittance: impl FnMut(DVec3) -> f64,
) -> Reflected {
    let mut sum = Reflected::default();
    let SampleCounts { light, cosine, lobe } = counts;
    for i in 0..light + cosine + lobe {
        // Each sample draws both numbers even if its direction is discarded, so that later samples keep their
        // numbers.
        let u = [random.random(), random.random()];
        let drawn = if i < light {
            Some(environment.sample(u))
        } else if i < light + cosine {
            Some(surface.sample_cosine(u))
        } else {
            surface.sample_lobe(u)
        };
        let Some((d, reflected)) = drawn.and_then(|d| Some((d, surface.reflect(d, 0.0)?))) else { continue };
        let (radiance, by_light) = environment.at(d);
        let density = f64::from(light) * by_light
            + f64::from(cosine) * surface.cosine_density(d)
            + f64::from(lobe) * surface.lobe_density(d);
        if !(density > 0.0) {
            continue;
        }
        let open = transmittance(d);
        for c in 0..3 {
            let seen = open * radiance[c];
            sum.diffuse[c] += seen / density * reflected.diffuse[c];
            sum.specular[c] += (seen + (1.0 - open) * blocked[c]) / density * reflected.specular[c];
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::light::Material;
    use crate::texel_directions;

    fn lamp() -> EnvMap {
        EnvMap::from_fn(32, 16, |d| {
            let spot = (30.0 * (d.dot(DVec3::new(0.6, 0.0, 0.8)) - 1.0)).exp() as f32;
            [6.0 * spot + 0.2, 3.0 * spot + 0.1, 0.3 + 0.2 * d.z as f32]
        })
    }

    fn surface() -> Reflector {
        let material = Material { albedo: [0.7, 0.5, 0.2], metal: 0.4, rough: 0.4, conserves_energy: true };
        Reflector::new(DVec3::Z, DVec3::new(-0.48, 0.36, 0.8), material)
    }

    /// A half-opaque curtain hides one side of the sky.
    fn curtain(d: DVec3) -> f64 {
        if d.x > 0.3 { 0.25 } else { 1.0 }
    }

    /// Mean and standard error of the luminance over independent estimates.
    fn mean(counts: SampleCounts, of: impl Fn(&Reflected) -> f64) -> (f64, f64) {
        let (light, r, n) = (EnvSampler::new(lamp()), surface(), 3000);
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let values: Vec<f64> =
            (0..n).map(|_| of(&estimate(&r, &light, [0.3; 3], counts, &mut random, curtain))).collect();
        let mean = values.iter().sum::<f64>() / f64::from(n);
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / f64::from(n - 1);
        (mean, (variance / f64::from(n)).sqrt())
    }

    /// The same integral by quadrature over small parts of texels.
    fn exact() -> Reflected {
        let (light, r, mut sum) = (EnvSampler::new(lamp()), surface(), Reflected::default());
        for (d, w) in texel_directions(32 * 40, 16 * 40) {
            let Some(s) = r.reflect(d, 0.0) else { continue };
            let (l, open) = (light.at(d).0, curtain(d));
            for c in 0..3 {
                sum.diffuse[c] += w * open * l[c] * s.diffuse[c];
                sum.specular[c] += w * (open * l[c] + (1.0 - open) * 0.3) * s.specular[c];
            }
        }
        sum
    }

    #[test]
    fn estimate_is_unbiased_for_every_sampling_mixture() {
        let want = exact();
        for (light, cosine, lobe) in [(8, 4, 4), (0, 0, 16), (0, 12, 4), (14, 0, 2)] {
            let counts = SampleCounts { light, cosine, lobe };
            for (part, want) in [
                ((|r: &Reflected| r.diffuse[0]) as fn(&Reflected) -> f64, want.diffuse[0]),
                (|r: &Reflected| r.specular[1], want.specular[1]),
            ] {
                let (got, error) = mean(counts, part);
                assert!((got - want).abs() < 4.0 * error, "{counts:?}: {got} +- {error}, not {want}");
                assert!(error < 0.05 * want, "{counts:?}: an error of {error} would excuse anything");
            }
        }
        // Negative control: without the curtain the integral differs by much more than those errors.
        let (light, r) = (EnvSampler::new(lamp()), surface());
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let open = estimate(&r, &light, [0.3; 3], SampleCounts::of(60_000, &light), &mut random, |_| 1.0);
        assert!(open.diffuse[0] > 1.5 * want.diffuse[0]);
    }

    #[test]
    fn sampling_density_integrates_to_one_and_matches_the_samples() {
        let light = EnvSampler::new(lamp());
        let total: f64 = texel_directions(32, 16).iter().map(|(d, w)| light.at(*d).1 * w).sum();
        assert!((total - 1.0).abs() < 1e-9, "{total}");
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let side = |d: DVec3| d.x > 0.0 && d.z > 0.3;
        let drawn = (0..20_000).filter(|_| side(light.sample([random.random(), random.random()]))).count();
        let fine = texel_directions(32 * 8, 16 * 8);
        let want: f64 = fine.iter().filter(|(d, _)| side(*d)).map(|(d, w)| light.at(*d).1 * w).sum();
        assert!((drawn as f64 / 20_000.0 - want).abs() < 0.01, "{drawn} {want}");
        let even = fine.iter().filter(|(d, _)| side(*d)).map(|(_, w)| w).sum::<f64>() / (4.0 * PI);
        assert!((want - even).abs() > 0.1, "the control: even draws would fall elsewhere");
    }

    #[test]
    fn dark_environments_and_single_samples_give_finite_results() {
        let dark = EnvSampler::new(EnvMap::constant(8, 4, [0.0; 3]));
        assert_eq!(SampleCounts::of(8, &dark).light, 0);
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let nothing = estimate(&surface(), &dark, [0.0; 3], SampleCounts::of(8, &dark), &mut random, |_| 1.0);
        assert_eq!(nothing, Reflected::default());
        let bright = EnvSampler::new(EnvMap::constant(8, 4, [1e30; 3]));
        let one = estimate(&surface(), &bright, [0.0; 3], SampleCounts::of(1, &bright), &mut random, |_| 1.0);
        assert!(one.diffuse.iter().chain(&one.specular).all(|v| v.is_finite()));
    }
}
