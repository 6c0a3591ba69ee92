//! Strong small lights of the photographs, found by the shadows they cast.
//!
//! Under the true light, what is left of a surface's colour when its irradiance is divided out has as few edges as its
//! material. A light whose shadows are sharper than the visibility field leaves the edges of its shadows in it. So a
//! direction is judged by the variation of `ln(colour / irradiance)` between neighbours, when a light from there is added to
//! an even sky through its measured transmittance. It is taken only where it does better than the same light through the
//! visibility field: a scene whose shadows are soft needs none.

mod detected_light;
mod neighbours;
mod split;

use rayon::prelude::*;

use crate::materials;
use detected_light::DetectedLight;
use neighbours::Neighbours;
use relume_engine::cpu::evaluation;
use relume_engine::{TrainState, fibonacci_sphere};
use relume_scene::light::{UNOCCLUDED_SH0, sh_eval};
use relume_scene::{Camera, Field, Gaussians, MAX_LIGHTS, SplitLight};
pub use split::{split, start};

/// Directions of the first search.
const DIRECTIONS: usize = 160;
/// Directions of the first search from which finer ones start.
const STARTS: usize = 5;
/// Sine of the elevation below which no light is looked for.
const MIN_ELEVATION_SINE: f32 = -0.2;
/// Angles of the finer searches, radians: each tries six directions around the best one so far.
const FINER: [f32; 5] = [0.14, 0.07, 0.035, 0.018, 0.009];
/// Irradiances that are tried, of a surface turned to the light, over that of an open one under the sky.
const STRENGTHS: [f32; 7] = [0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0];
/// Angular radii that are tried, radians.
const RADII: [f32; 3] = [0.005, 0.06, 0.15];
/// Least strength of a light, mean of the channels: the visibility field draws the shadows of weaker ones well enough.
const MIN_STRENGTH: f32 = 1.5;
/// A light has to lower the variation by this share, against the same light with soft shadows.
const MIN_GAIN: f32 = 0.04;
/// A light moves only if that lowers the variation by this share.
const MIN_MOVE_GAIN: f32 = 0.01;
/// Photographs in which Gaussians are looked for.
const PHOTOS: usize = 12;
/// Least pixels in which a Gaussian that is looked at is seen.
const MIN_VISIBLE_PIXELS: f32 = 2.0;
/// Linear colours that say something about shading: neither black nor clipped.
const INFORMATIVE_RANGE: (f32, f32) = (0.01, 0.95);
/// Least colour and irradiance of which a logarithm is taken.
const MIN_LOG_ARGUMENT: f32 = 2e-3;
/// Factor of the components of a direction in Y_1m.
const LINEAR_BAND: f32 = 0.488_602_5;

/// Looks for at most `most` lights in a state whose visibility was measured. `seen`: pixels in which each Gaussian is seen;
/// `previous`: lights that were found before, which stay where they are unless it is clearly better to move.
pub fn search(state: &TrainState, seen: &[f32], most: usize, previous: &[SplitLight]) -> Vec<DetectedLight> {
    let scene = LightSearch::new(state, seen);
    let mut found: Vec<DetectedLight> = Vec::new();
    let mut irradiance = scene.sky();
    while found.len() < most.min(MAX_LIGHTS) {
        let near = previous.get(found.len()).and_then(|previous| scene.accepted(&irradiance, Some(previous)));
        let Some((light, with)) = near.or_else(|| scene.accepted(&irradiance, None)) else { break };
        found.push(light);
        irradiance = with;
    }
    found
}

/// Pixels in which each Gaussian is seen, over a dozen of `cameras`.
pub fn seen(state: &TrainState, cameras: &[&Camera]) -> Vec<f32> {
    let mut out = vec![0.0; state.model.gaussians.len()];
    for camera in cameras.iter().step_by((cameras.len() / PHOTOS).max(1)) {
        out.iter_mut().zip(evaluation::blending_weights(state, camera)).for_each(|(sum, w)| *sum += w);
    }
    out
}

/// What is compared.
struct LightSearch<'a> {
    state: &'a TrainState,
    normals: Vec<[f32; 3]>,
    /// `ln` of linear colours.
    colours: Vec<[f32; 3]>,
    neighbours: Neighbours,
}

/// A light on trial.
struct LightCandidate {
    light: SplitLight,
    strength: [f32; 3],
    variation: f32,
    /// Irradiance with it.
    irradiance: Vec<[f32; 3]>,
}

impl<'a> LightSearch<'a> {
    fn new(state: &'a TrainState, seen: &[f32]) -> Self {
        let g = &state.model.gaussians;
        let mut colours: Vec<[f32; 3]> = (0..g.len()).map(|i| materials::colour(g, i)).collect();
        let tells = |c: &[f32; 3]| {
            c.iter().all(|v| *v < INFORMATIVE_RANGE.1) && c.iter().any(|v| *v > INFORMATIVE_RANGE.0)
        };
        let used =
            (0..g.len()).filter(|i| seen[*i] > MIN_VISIBLE_PIXELS && tells(&colours[*i])).map(|i| i as u32);
        let neighbours = Neighbours::of(g, &used.collect::<Vec<_>>(), seen);
        neighbours.smooth(&mut colours);
        colours.iter_mut().for_each(|c| *c = c.map(|v| v.max(MIN_LOG_ARGUMENT).ln()));
        Self { state, normals: evaluation::normals(state), colours, neighbours }
    }

    fn gaussians(&self) -> &Gaussians {
        &self.state.model.gaussians
    }

    /// Irradiance under an even sky of radiance 1, over pi.
    fn sky(&self) -> Vec<[f32; 3]> {
        let g = self.gaussians();
        let open = |i: usize| {
            let (c, n) = (g.row(Field::Visibility, i), self.normals[i]);
            let linear = if c.len() >= 4 { c[2] * n[2] - c[1] * n[1] - c[3] * n[0] } else { 0.0 };
            // Funk-Hecke: the clamped cosine's degree 1 is 2/3 of its degree 0.
            [(c[0] / UNOCCLUDED_SH0 + 2.0 / 3.0 * LINEAR_BAND * linear).clamp(0.05, 1.0); 3]
        };
        let mut sky: Vec<[f32; 3]> = (0..g.len()).map(open).collect();
        self.neighbours.smooth(&mut sky);
        sky
    }

    /// The best light beside `irradiance` and the irradiance with it, if the evidence is enough.
    fn accepted(
        &self,
        irradiance: &[[f32; 3]],
        previous: Option<&SplitLight>,
    ) -> Option<(DetectedLight, Vec<[f32; 3]>)> {
        let best = self.best(irradiance, previous)?;
        let soft = self.evaluate(irradiance, best.light, self.soft_visibility(best.light));
        let gain = 1.0 - best.variation / soft.variation.max(1e-12);
        let is_strong = best.strength.iter().sum::<f32>() >= 3.0 * MIN_STRENGTH;
        let found = DetectedLight { light: best.light, strength: best.strength, gain };
        (gain > MIN_GAIN && is_strong).then_some((found, best.irradiance))
    }

    /// The best light beside `irradiance`: near the `previous` one, which stays unless another is clearly better, or anywhere.
    fn best(&self, irradiance: &[[f32; 3]], previous: Option<&SplitLight>) -> Option<LightCandidate> {
        let mut best = match previous {
            Some(previous) => vec![self.candidates(irradiance, &[*previous]).pop()?],
            None => {
                let all =
                    fibonacci_sphere(DIRECTIONS).into_iter().filter(|d| d[2] > MIN_ELEVATION_SINE).map(point);
                let mut first = self.candidates(irradiance, &all.collect::<Vec<_>>());
                first.sort_by(|a, b| a.variation.total_cmp(&b.variation));
                first.truncate(STARTS);
                first
            }
        };
        for start in &mut best {
            self.refine(irradiance, start, if previous.is_some() { MIN_MOVE_GAIN } else { 0.0 });
        }
        best.into_iter().min_by(|a, b| a.variation.total_cmp(&b.variation))
    }

    /// Moves `best` to near directions and radii that lower the variation by more than the share `least`.
    fn refine(&self, irradiance: &[[f32; 3]], best: &mut LightCandidate, least: f32) {
        let limit = (1.0 - least) * best.variation;
        let take = |candidates: Vec<LightCandidate>, best: &mut LightCandidate| {
            for trial in candidates.into_iter().filter(|t| t.variation < limit) {
                if trial.variation < best.variation {
                    *best = trial;
                }
            }
        };
        for angle in FINER {
            take(self.candidates(irradiance, &around(best.light.direction, angle).map(point)), best);
        }
        let radii = RADII.map(|radius| SplitLight { radius, ..best.light });
        take(self.candidates(irradiance, &radii), best);
    }

    /// `lights`, each at its best strength.
    fn candidates(&self, irradiance: &[[f32; 3]], lights: &[SplitLight]) -> Vec<LightCandidate> {
        let arriving: Vec<(SplitLight, Vec<f32>)> = lights
            .chunks(MAX_LIGHTS)
            .flat_map(|lights| {
                let shares = evaluation::arriving(self.state, lights);
                let of = move |k: usize| shares.iter().map(|s| s[k]).collect();
                lights.iter().enumerate().map(move |(k, light)| (*light, of(k))).collect::<Vec<_>>()
            })
            .collect();
        arriving.into_par_iter().map(|(light, shares)| self.evaluate(irradiance, light, shares)).collect()
    }

    /// `light` at its best strength in each channel, when these `shares` of it arrive.
    fn evaluate(&self, irradiance: &[[f32; 3]], light: SplitLight, shares: Vec<f32>) -> LightCandidate {
        let cos = |n: &[f32; 3]| (0..3).map(|k| n[k] * light.direction[k]).sum::<f32>().max(0.0);
        let added = shares.iter().zip(&self.normals);
        let mut added: Vec<[f32; 1]> = added.map(|(share, n)| [share * cos(n)]).collect();
        self.neighbours.smooth(&mut added);
        let (mut strength, mut variation) = ([0.0; 3], 0.0);
        for c in 0..3 {
            let tried = STRENGTHS.map(|s| (self.variation(irradiance, c, &added, s), s));
            let least = tried.into_iter().fold((f32::INFINITY, 0.0), |a, b| if b.0 < a.0 { b } else { a });
            variation += least.0;
            strength[c] = least.1;
        }
        let with = |(e, [a]): (&[f32; 3], &[f32; 1])| std::array::from_fn(|c| e[c] + strength[c] * a);
        let irradiance = irradiance.iter().zip(&added).map(with).collect();
        LightCandidate { light, strength, variation, irradiance }
    }

    /// Variation of one channel with `strength * added` beside `irradiance`.
    fn variation(&self, irradiance: &[[f32; 3]], c: usize, added: &[[f32; 1]], strength: f32) -> f32 {
        let lit =
            irradiance.iter().zip(added).map(|(e, [a])| (e[c] + strength * a).max(MIN_LOG_ARGUMENT).ln());
        let logs: Vec<f32> = self.colours.iter().zip(lit).map(|(colour, lit)| colour[c] - lit).collect();
        self.neighbours.variation(&logs)
    }

    /// What arrives of `light` through the visibility field.
    fn soft_visibility(&self, light: SplitLight) -> Vec<f32> {
        let g = self.gaussians();
        let mut basis = [0.0f32; 64];
        sh_eval(g.visibility_degree(), light.direction, &mut basis);
        let field =
            |i: usize| g.row(Field::Visibility, i).iter().zip(&basis).map(|(c, y)| c * y).sum::<f32>();
        (0..g.len()).map(|i| field(i).clamp(0.0, 1.0)).collect()
    }
}

/// A light that is as small as is tried.
fn point(direction: [f32; 3]) -> SplitLight {
    SplitLight { direction, radius: RADII[0] }
}

/// Six directions `angle` radians around one.
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
