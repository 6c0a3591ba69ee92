//! Minimises the variation of albedo over the light.

use crate::lights::environment::transport::Transport;
use crate::lights::environment::variation::Variation;

/// Number of steps.
const STEPS: usize = 200;
/// Largest change of the logarithm of a light in one step, about.
const RATE: f32 = 0.085;
/// Shares of the last mean of gradients and of their squares that remain.
const MEMORY: [f32; 2] = [0.8, 0.95];
/// Difference of logarithms of albedo above which a pair counts as an edge of the material: at the first and at the last step.
const EDGE: [f32; 2] = [0.3, 0.05];
/// Weight of the relative entropy between the light and the present environment.
const ENTROPY: f32 = 0.08;

/// The light before the solution.
pub(super) struct Prior {
    /// Radiance of each direction of the sky, then irradiance of each dominant light.
    pub(super) light: Vec<[f32; 3]>,
    /// Number of directions of the sky.
    pub(super) sky: usize,
}

/// The light with the least variation of albedo, started at `prior`. The sum of irradiance over all pixels stays that of `prior` in each channel: the
/// variation does not determine the level.
pub(super) fn solve(transport: &Transport, variation: &Variation, prior: &Prior) -> Vec<[f32; 3]> {
    let weights: Vec<[f32; 3]> = variation.pixels.iter().map(|pixels| [*pixels; 3]).collect();
    let by_pixels = transport.transposed(&weights);
    let level = |light: &[[f32; 3]], c: usize| -> f32 {
        light.iter().zip(&by_pixels).map(|(light, t)| light[c] * t[c]).sum()
    };
    let levels: [f32; 3] = std::array::from_fn(|c| level(&prior.light, c));
    let mut light = prior.light.clone();
    let (mut mean, mut square) = (vec![[0.0f32; 3]; light.len()], vec![0.0f32; light.len()]);
    for step in 0..STEPS {
        let edge = EDGE[0] * (EDGE[1] / EDGE[0]).powf(step as f32 / STEPS as f32);
        let by_light = transport.transposed(&variation.gradient(&transport.irradiance(&light), edge));
        let sky_mean: [f32; 3] = std::array::from_fn(|c| {
            light[..prior.sky].iter().map(|light| light[c]).sum::<f32>() / prior.sky as f32
        });
        for d in 0..light.len() {
            let slope = std::array::from_fn(|c| {
                let entropy = if d < prior.sky {
                    entropy_slope(light[d][c], prior.light[d][c], sky_mean[c]) / prior.sky as f32
                } else {
                    0.0
                };
                by_light[d][c] * light[d][c] + ENTROPY * entropy
            });
            advance(&mut light[d], &mut mean[d], &mut square[d], slope);
        }
        for c in 0..3 {
            let gain = levels[c] / level(&light, c).max(f32::MIN_POSITIVE);
            light.iter_mut().for_each(|light| light[c] *= gain);
        }
    }
    light
}

/// Derivative of the relative entropy `L ln(L / prior) / mean` by `ln L`, apart from a term that only changes the level.
fn entropy_slope(light: f32, prior: f32, mean: f32) -> f32 {
    light / mean.max(f32::MIN_POSITIVE) * (light / prior.max(1e-6)).max(f32::MIN_POSITIVE).ln()
}

/// One step of Adam on the logarithms of a light. The channels share the mean square, so that its colour changes only by evidence.
fn advance(light: &mut [f32; 3], mean: &mut [f32; 3], square: &mut f32, slope: [f32; 3]) {
    let sum: f32 = slope.iter().map(|s| s * s).sum();
    *square = MEMORY[1] * *square + (1.0 - MEMORY[1]) * sum;
    for c in 0..3 {
        mean[c] = MEMORY[0] * mean[c] + (1.0 - MEMORY[0]) * slope[c];
        light[c] *= (-RATE * mean[c] / square.sqrt().max(1e-12)).exp();
    }
}
