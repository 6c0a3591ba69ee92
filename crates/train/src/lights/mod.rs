//! Detects strong small lights in the photographs by the shadows that they cast.
//!
//! Under the true light, a surface colour divided by its irradiance has only the edges of the material. The edges of
//! shadows remain if a light casts sharper shadows than the visibility field represents. The criterion for a
//! direction is the variation of `ln(colour / irradiance)` between neighbours if a light from there is added to a
//! uniform sky through its measured transmittance. The light is accepted only if its variation is lower than that of
//! the same light through the visibility field: a scene with soft shadows needs none.

mod detected_light;
mod environment;
mod neighbours;
mod split;

use rayon::prelude::*;

use crate::materials;
use detected_light::DetectedLight;
pub use environment::solve as solve_environment;
use neighbours::Neighbours;
use relume_engine::{TrainState, evaluation, fibonacci_sphere};
use relume_scene::light::{UNOCCLUDED_SH0, sh_eval};
use relume_scene::{Camera, DisplayRange, Field, MAX_LIGHTS, SplitLight};
pub use split::{split, start};

/// Number of directions of the first search.
const DIRECTIONS: usize = 160;
/// Number of directions of the first search that are refined.
const STARTS: usize = 5;
/// Sine of the elevation below which no light is searched.
const MIN_ELEVATION_SINE: f32 = -0.2;
/// Angles of the refinement steps, radians. Each step tests six directions around the best one so far.
const FINER: [f32; 5] = [0.14, 0.07, 0.035, 0.018, 0.009];
/// Tested irradiances of a surface that faces the light, relative to that of an unoccluded one under the sky.
const STRENGTHS: [f32; 7] = [0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0];
/// Tested angular radii, radians.
const RADII: [f32; 3] = [0.005, 0.06, 0.15];
/// Least strength of a light, mean of the channels. The visibility field represents the shadows of weaker lights
/// sufficiently.
const MIN_STRENGTH: f32 = 0.5;
/// Least share by which a light must lower the variation, compared with the same light with soft shadows.
const MIN_GAIN: f32 = 0.04;
/// Least share by which the variation must fall for a light to move.
const MIN_MOVE_GAIN: f32 = 0.01;
/// Number of lights that are measured together, which bounds the memory.
const LIGHTS_AT_ONCE: usize = 32;
/// Number of photographs in which visible Gaussians are determined.
const PHOTOS: usize = 12;
/// Least number of visible pixels of a Gaussian that is used.
const MIN_VISIBLE_PIXELS: f32 = 2.0;
/// Linear colours with information about shading, over the peak of the range for the upper one: neither black nor clipped.
const INFORMATIVE_RANGE: (f32, f32) = (0.01, 0.95);
/// Lower bound of colour and irradiance before the logarithm.
const MIN_LOG_ARGUMENT: f32 = 2e-3;
/// Factor of a direction's components in Y_1m.
const LINEAR_BAND: f32 = 0.488_602_5;

/// Searches for at most `most` lights in a state with measured visibility. `seen`: number of pixels in which each
/// Gaussian is visible. `range`: that of the photographs. `previous`: lights that were found before, which move only if another position is clearly
/// better.
pub fn search(
    state: &TrainState,
    seen: &[f32],
    range: DisplayRange,
    most: usize,
    previous: &[SplitLight],
) -> Vec<DetectedLight> {
    let scene = LightSearch::new(state, seen, range);
    let mut found: Vec<DetectedLight> = Vec::new();
    let mut irradiance = scene.sky();
    while found.len() < most.min(MAX_LIGHTS) {
        let previous = previous.get(found.len());
        let near = previous.and_then(|previous| scene.accepted(&irradiance, &found, Some(previous)));
        let Some((light, with)) = near.or_else(|| scene.accepted(&irradiance, &found, None)) else { break };
        found.push(light);
        irradiance = with;
    }
    found
}

/// Number of pixels in which each Gaussian is visible, over about [`PHOTOS`] of `cameras`.
pub fn seen(state: &TrainState, cameras: &[&Camera]) -> Vec<f32> {
    let mut out = vec![0.0; state.model.gaussians.len()];
    for camera in cameras.iter().step_by((cameras.len() / PHOTOS).max(1)) {
        out.iter_mut().zip(evaluation::blending_weights(state, camera)).for_each(|(sum, w)| *sum += w);
    }
    out
}

/// Inputs of the search. All values are those of the members of `neighbours`.
struct LightSearch<'a> {
    state: &'a TrainState,
    normals: Vec<[f32; 3]>,
    /// Logarithms of linear colours.
    colours: Vec<[f32; 3]>,
    neighbours: Neighbours,
}

/// A tested light.
#[derive(Debug, Clone, Copy)]
struct LightCandidate {
    light: SplitLight,
    strength: [f32; 3],
    variation: f32,
}

impl<'a> LightSearch<'a> {
    fn new(state: &'a TrainState, seen: &[f32], range: DisplayRange) -> Self {
        let g = &state.model.gaussians;
        let colours: Vec<[f32; 3]> = (0..g.len()).map(|i| materials::colour(g, i, range)).collect();
        let tells = |c: &[f32; 3]| {
            c.iter().all(|v| *v < INFORMATIVE_RANGE.1 * range.peak())
                && c.iter().any(|v| *v > INFORMATIVE_RANGE.0)
        };
        let used =
            (0..g.len()).filter(|i| seen[*i] > MIN_VISIBLE_PIXELS && tells(&colours[*i])).map(|i| i as u32);
        let neighbours = Neighbours::of(g, &used.collect::<Vec<_>>(), seen);
        let mut colours = neighbours.of_members(&colours);
        neighbours.smooth(&mut colours);
        colours.iter_mut().for_each(|c| *c = c.map(|v| v.max(MIN_LOG_ARGUMENT).ln()));
        let normals = neighbours.of_members(&evaluation::normals(state));
        Self { state, normals, colours, neighbours }
    }

    /// The visibility field of each member.
    fn fields(&self) -> impl Iterator<Item = &[f32]> {
        let g = &self.state.model.gaussians;
        self.neighbours.members().iter().map(|i| g.row(Field::Visibility, *i as usize))
    }

    /// Share of each of `lights` that arrives at each member.
    fn shares(&self, lights: &[SplitLight]) -> Vec<Vec<f32>> {
        evaluation::light_shares(self.state, lights, self.neighbours.members())
    }

    /// Irradiance under a uniform sky of radiance 1, divided by pi.
    fn sky(&self) -> Vec<[f32; 3]> {
        let open = |(c, n): (&[f32], &[f32; 3])| {
            let linear = if c.len() >= 4 { c[2] * n[2] - c[1] * n[1] - c[3] * n[0] } else { 0.0 };
            // Funk-Hecke: the clamped cosine's degree 1 is 2/3 of its degree 0.
            [(c[0] / UNOCCLUDED_SH0 + 2.0 / 3.0 * LINEAR_BAND * linear).clamp(0.05, 1.0); 3]
        };
        let mut sky: Vec<[f32; 3]> = self.fields().zip(&self.normals).map(open).collect();
        self.neighbours.smooth(&mut sky);
        sky
    }

    /// The best light in addition to `irradiance`, which contains those of `found`, and the irradiance with it; `None` without sufficient
    /// evidence.
    fn accepted(
        &self,
        irradiance: &[[f32; 3]],
        found: &[DetectedLight],
        previous: Option<&SplitLight>,
    ) -> Option<(DetectedLight, Vec<[f32; 3]>)> {
        let best = self.best(irradiance, found, previous)?;
        let added = self.added_irradiance(best.light, &self.soft_visibility(best.light));
        let soft = self.evaluate(irradiance, best.light, &added);
        let gain = 1.0 - best.variation / soft.variation.max(1e-12);
        let is_strong = best.strength.iter().sum::<f32>() >= 3.0 * MIN_STRENGTH;
        if !(gain > MIN_GAIN && is_strong && is_apart(best.light.direction, found)) {
            return None;
        }
        let shares = self.shares(&[best.light]).pop()?;
        let added = self.added_irradiance(best.light, &shares);
        let with = |(e, [a]): (&[f32; 3], &[f32; 1])| std::array::from_fn(|c| e[c] + best.strength[c] * a);
        let irradiance = irradiance.iter().zip(&added).map(with).collect();
        Some((DetectedLight { light: best.light, strength: best.strength, gain }, irradiance))
    }

    /// The best light in addition to `irradiance`: near the `previous` light, which moves only if another position is
    /// clearly better; without a `previous` light, in any direction apart from those of `found`.
    fn best(
        &self,
        irradiance: &[[f32; 3]],
        found: &[DetectedLight],
        previous: Option<&SplitLight>,
    ) -> Option<LightCandidate> {
        let mut best = match previous {
            Some(previous) => vec![self.candidates(irradiance, &[*previous]).pop()?],
            None => {
                let all = fibonacci_sphere(DIRECTIONS).into_iter();
                let all = all.filter(|d| d[2] > MIN_ELEVATION_SINE && is_apart(*d, found)).map(point);
                let mut first = self.candidates(irradiance, &all.collect::<Vec<_>>());
                first.sort_by(|a, b| a.variation.total_cmp(&b.variation));
                first.truncate(STARTS);
                first
            }
        };
        self.refine(irradiance, &mut best, if previous.is_some() { MIN_MOVE_GAIN } else { 0.0 });
        best.into_iter().min_by(|a, b| a.variation.total_cmp(&b.variation))
    }

    /// Moves each of `starts` to nearby directions and radii that lower its variation by more than the share `least`.
    fn refine(&self, irradiance: &[[f32; 3]], starts: &mut [LightCandidate], least: f32) {
        let limits: Vec<f32> = starts.iter().map(|start| (1.0 - least) * start.variation).collect();
        for angle in FINER {
            let near = |light: SplitLight| around(light.direction, angle).map(point).to_vec();
            self.take_better(irradiance, starts, &limits, near);
        }
        let resized = |light: SplitLight| RADII.map(|radius| SplitLight { radius, ..light }).to_vec();
        self.take_better(irradiance, starts, &limits, resized);
    }

    /// Replaces each of `starts` by the best of the lights `near` it, if that has less variation, and less than its limit.
    /// All lights are tested together, so that all processors have work.
    fn take_better(
        &self,
        irradiance: &[[f32; 3]],
        starts: &mut [LightCandidate],
        limits: &[f32],
        near: impl Fn(SplitLight) -> Vec<SplitLight>,
    ) {
        let lights: Vec<Vec<SplitLight>> = starts.iter().map(|start| near(start.light)).collect();
        let mut candidates = self.candidates(irradiance, &lights.concat()).into_iter();
        for ((start, lights), limit) in starts.iter_mut().zip(&lights).zip(limits) {
            for trial in candidates.by_ref().take(lights.len()) {
                if trial.variation < *limit && trial.variation < start.variation {
                    *start = trial;
                }
            }
        }
    }

    /// Evaluates `lights`, each at its best strength.
    fn candidates(&self, irradiance: &[[f32; 3]], lights: &[SplitLight]) -> Vec<LightCandidate> {
        let evaluate = |lights: &[SplitLight]| -> Vec<LightCandidate> {
            let shares = self.shares(lights);
            let tested = lights.par_iter().zip(&shares);
            tested
                .map(|(light, shares)| {
                    self.evaluate(irradiance, *light, &self.added_irradiance(*light, shares))
                })
                .collect()
        };
        lights.chunks(LIGHTS_AT_ONCE).flat_map(evaluate).collect()
    }

    /// Irradiance by `light` at strength 1. `shares`: the share of it that arrives at each member.
    fn added_irradiance(&self, light: SplitLight, shares: &[f32]) -> Vec<[f32; 1]> {
        let cos = |n: &[f32; 3]| (0..3).map(|k| n[k] * light.direction[k]).sum::<f32>().max(0.0);
        let mut added: Vec<[f32; 1]> =
            shares.iter().zip(&self.normals).map(|(share, n)| [share * cos(n)]).collect();
        self.neighbours.smooth(&mut added);
        added
    }

    /// Evaluates `light`, which adds `added` at strength 1, at its best strength in each channel.
    fn evaluate(&self, irradiance: &[[f32; 3]], light: SplitLight, added: &[[f32; 1]]) -> LightCandidate {
        let (mut strength, mut variation) = ([0.0; 3], 0.0);
        for c in 0..3 {
            let tried = self.variations(irradiance, c, added).into_iter().zip(STRENGTHS);
            let least = tried.fold((f32::INFINITY, 0.0), |a, b| if b.0 < a.0 { b } else { a });
            variation += least.0;
            strength[c] = least.1;
        }
        LightCandidate { light, strength, variation }
    }

    /// Variation of one channel with `added` in addition to `irradiance`, at each of [`STRENGTHS`].
    fn variations(&self, irradiance: &[[f32; 3]], c: usize, added: &[[f32; 1]]) -> [f32; STRENGTHS.len()] {
        let lit = irradiance.iter().zip(added);
        let of = |(colour, (e, [a])): (&[f32; 3], (&[f32; 3], &[f32; 1]))| {
            STRENGTHS.map(|strength| colour[c] - (e[c] + strength * a).max(MIN_LOG_ARGUMENT).ln())
        };
        let logs: Vec<_> = self.colours.iter().zip(lit).map(of).collect();
        self.neighbours.variations(&logs)
    }

    /// Shares of `light` that arrive through the visibility field.
    fn soft_visibility(&self, light: SplitLight) -> Vec<f32> {
        let mut basis = [0.0f32; 64];
        sh_eval(self.state.model.gaussians.visibility_degree(), light.direction, &mut basis);
        let at = |field: &[f32]| field.iter().zip(&basis).map(|(c, y)| c * y).sum::<f32>();
        self.fields().map(|field| at(field).clamp(0.0, 1.0)).collect()
    }
}

/// True if texels near `direction` belong to none of the lights `found`.
fn is_apart(direction: [f32; 3], found: &[DetectedLight]) -> bool {
    let angle = |light: &DetectedLight| {
        glam::Vec3::from(direction).angle_between(light.light.direction.into()) - light.light.radius
    };
    found.iter().all(|light| f64::from(angle(light)) > split::REACH)
}

/// A light of the smallest tested radius.
fn point(direction: [f32; 3]) -> SplitLight {
    SplitLight { direction, radius: RADII[0] }
}

/// Six directions `angle` radians around `direction`.
fn around(direction: [f32; 3], angle: f32) -> [[f32; 3]; 6] {
    let z = glam::Vec3::from(direction);
    let (x, y) = z.any_orthonormal_pair();
    std::array::from_fn(|k| {
        let (sin, cos) = (k as f32 * std::f32::consts::FRAC_PI_3).sin_cos();
        (z + angle.tan() * (cos * x + sin * y)).normalize().to_array()
    })
}

#[cfg(test)]
mod tests;
