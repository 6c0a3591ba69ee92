//! Adam over all parameters of a model (Kingma and Ba 2015).

use multiversion::multiversion;
use rayon::prelude::*;

use crate::engine::Gradients;
use crate::engine::constants::{ADAM_BETA1 as BETA1, ADAM_BETA2 as BETA2, ADAM_EPSILON as EPSILON};
use crate::scene::{Field, Gaussians, Model};
use crate::train::LearningRates;

/// Progress from which sheen trains: earlier it takes what normals, roughness and light have to explain
/// (docs/experiments.md, "Sheen").
const SHEEN_FROM: f32 = 0.7;
/// Gaussians a task takes.
const CHUNK: usize = 512;

/// First and second moments, shaped like the model.
#[derive(Debug, Clone, PartialEq)]
pub struct Moments {
    /// First moments of the Gaussians.
    pub first: Gaussians,
    /// Second moments of the Gaussians.
    pub second: Gaussians,
    /// Moments of prototypes then environment: first, second.
    pub globals: [Vec<[f32; 3]>; 2],
}

/// Step sizes of this step, per field; zero leaves a field alone.
#[derive(Debug, Clone, Copy)]
pub struct StepSizes {
    /// Per field.
    pub fields: [f32; Field::COUNT],
    /// Albedo prototypes.
    pub prototypes: f32,
    /// Raw environment texels.
    pub environment: f32,
}

impl StepSizes {
    /// The schedule at `progress` in [0, 1]; `material` says whether the physically based branch trains.
    pub fn new(rates: &LearningRates, progress: f32, material: bool, visibility: bool) -> Self {
        let mean = rates.mean * (rates.mean_final / rates.mean.max(1e-20)).powf(progress);
        // Over the second half shapes and radiance fall to a thirtieth; materials and light, which are not there yet by then, over
        // the last quarter to a tenth.
        let second_half = (2.0 * progress - 1.0).max(0.0);
        let late = (1.0f32 / 30.0).powf(second_half);
        let last_quarter = (4.0 * progress - 3.0).max(0.0);
        let on = if material { 0.1f32.powf(last_quarter) } else { 0.0 };
        let vis = if visibility { on } else { 0.0 };
        let mut fields = [0.0; Field::COUNT];
        let table = [
            (Field::Mean, mean),
            (Field::LogScale, rates.scale * late),
            (Field::Quaternion, rates.rotation * late),
            (Field::OpacityLogit, rates.opacity * late),
            (Field::Normal, rates.normal * on),
            (Field::MetalLogit, rates.material * on),
            (Field::RoughLogit, rates.material * on),
            (Field::Sheen, if progress < SHEEN_FROM { 0.0 } else { rates.sheen * on }),
            (Field::ProtoLogits, rates.scores * on),
            (Field::Residual, rates.residual * on),
            (Field::Visibility, rates.visibility * vis),
            (Field::Indirect, rates.visibility * vis),
            (Field::Radiance, rates.radiance * late),
        ];
        for (field, rate) in table {
            fields[field as usize] = rate;
        }
        Self { fields, prototypes: rates.prototypes * on, environment: rates.environment * on }
    }

    /// All sizes times `factor`.
    #[must_use]
    pub fn scaled(mut self, factor: f32) -> Self {
        self.fields.iter_mut().for_each(|f| *f *= factor);
        self.prototypes *= factor;
        self.environment *= factor;
        self
    }
}

impl Moments {
    /// Zero moments for `model`.
    pub fn zeroed(model: &Model) -> Self {
        let g = &model.gaussians;
        let zero = Gaussians::zeroed(g.len(), g.prototypes(), g.visibility_order(), g.radiance_order());
        let globals = vec![[0.0; 3]; model.prototypes.len() + model.env_raw.len()];
        Self { first: zero.clone(), second: zero, globals: [globals.clone(), globals] }
    }

    /// One Adam step. `ages`: how many steps geometry with radiance, and material with light, have trained, this one
    /// included.
    pub fn step(&mut self, model: &mut Model, gradients: &Gradients, sizes: &StepSizes, ages: [u32; 2]) {
        let correction = |age: u32, beta: f32| 1.0 - beta.powi(age.min(100_000) as i32);
        let corrections = ages.map(|age| (correction(age, BETA1), correction(age, BETA2).sqrt()));
        let layout = gradients.layout;
        let moments = self.first.fields_mut().zip(self.second.fields_mut());
        for ((field, width, data), ((_, _, first), (_, _, second))) in
            model.gaussians.fields_mut().zip(moments)
        {
            let (correction1, correction2) = corrections[usize::from(is_material(field))];
            let rate = sizes.fields[field as usize] / correction1;
            let range = layout.range(field);
            if rate == 0.0 || range.is_empty() {
                continue;
            }
            let rates: Vec<f32> = (0..width).map(|k| rate * share_of_rate(field, k)).collect();
            let chunks = data
                .par_chunks_mut(CHUNK * width)
                .zip(first.par_chunks_mut(CHUNK * width))
                .zip(second.par_chunks_mut(CHUNK * width))
                .zip(gradients.rows.par_chunks(CHUNK * layout.row));
            chunks.for_each_init(Vec::new, |scratch, (((data, first), second), rows)| {
                scratch.clear();
                for row in rows.chunks_exact(layout.row) {
                    scratch.extend(row[range.clone()].iter().copied().zip(rates.iter().copied()));
                }
                adam_all(data, [first, second], scratch, correction2);
            });
        }
        let (correction1, correction2) = corrections[1];
        let globals = model.prototypes.iter_mut().map(|p| (p, sizes.prototypes));
        let globals = globals.chain(model.env_raw.iter_mut().map(|p| (p, sizes.environment)));
        let [first, second] = &mut self.globals;
        let slopes = gradients.prototypes.iter().chain(&gradients.env_raw);
        for (((p, rate), (m, v)), g) in globals.zip(first.iter_mut().zip(second)).zip(slopes) {
            if rate > 0.0 {
                for c in 0..3 {
                    p[c] -= adam(&mut m[c], &mut v[c], g[c], rate / correction1, correction2);
                }
            }
        }
    }

    /// Moments of the Gaussians that survive density control; new ones (index beyond) start from zero.
    pub fn gather(&mut self, indices: &[Option<usize>]) {
        let pick: Vec<usize> = indices.iter().map(|i| i.unwrap_or(0)).collect();
        for moments in [&mut self.first, &mut self.second] {
            let mut picked = moments.gathered(&pick);
            for (_, width, data) in picked.fields_mut() {
                for (row, _) in data.chunks_mut(width.max(1)).zip(indices).filter(|(_, i)| i.is_none()) {
                    row.fill(0.0);
                }
            }
            *moments = picked;
        }
    }
}

/// Fields that only the physically based branch trains.
fn is_material(field: Field) -> bool {
    use Field::{Indirect, MetalLogit, Normal, ProtoLogits, Residual, RoughLogit, Sheen, Visibility};
    matches!(field, Normal | MetalLogit | RoughLogit | Sheen | ProtoLogits | Residual | Visibility | Indirect)
}

/// What of a field's step its float `k` takes: directions of radiance a twentieth of what its mean takes.
fn share_of_rate(field: Field, k: usize) -> f32 {
    if field == Field::Radiance && k >= 3 { 0.05 } else { 1.0 }
}

/// [`adam`] on every parameter of `data`, from `(gradient, rate)` pairs.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
fn adam_all(data: &mut [f32], [first, second]: [&mut [f32]; 2], slopes: &[(f32, f32)], correction2: f32) {
    let moments = first.iter_mut().zip(second);
    for ((p, (m, v)), (g, rate)) in data.iter_mut().zip(moments).zip(slopes) {
        *p -= adam(m, v, *g, *rate, correction2);
    }
}

/// Updates the moments and returns the step.
#[inline(always)]
fn adam(m: &mut f32, v: &mut f32, g: f32, rate: f32, correction2: f32) -> f32 {
    *m = BETA1 * *m + (1.0 - BETA1) * g;
    *v = BETA2 * *v + (1.0 - BETA2) * g * g;
    rate * *m / (v.sqrt() / correction2 + EPSILON)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn materials_keep_their_steps_to_the_last_quarter_and_sheen_comes_late() {
        let rates = LearningRates::default();
        let size =
            |field: Field, progress: f32| StepSizes::new(&rates, progress, true, true).fields[field as usize];
        assert_eq!(size(Field::RoughLogit, 0.75), rates.material);
        assert!((size(Field::RoughLogit, 1.0) - 0.1 * rates.material).abs() < 1e-6);
        assert_eq!(size(Field::Sheen, 0.69), 0.0);
        assert_eq!(size(Field::Sheen, 0.71), rates.sheen);
        assert!(size(Field::LogScale, 0.75) < 0.2 * rates.scale, "the control: shapes fall before");
    }
}
