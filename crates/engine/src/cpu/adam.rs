//! Adam over all parameters of a model.

use std::ops::Range;

use multiversion::multiversion;
use rayon::prelude::*;

use crate::adam::{FieldGroup, StepCounts, StepSizes, share_of_step};
use crate::{Gradients, Moments};
use relume_layout::constants::{ADAM_BETA1 as BETA1, ADAM_BETA2 as BETA2, ADAM_EPSILON as EPSILON};
use relume_scene::{Field, Model};

/// Gaussians per task.
const CHUNK: usize = 512;

/// One Adam step: updates `model` and its moments from `gradients`.
pub fn adam_step(
    model: &mut Model,
    moments: &mut Moments,
    gradients: &Gradients,
    sizes: &StepSizes,
    counts: StepCounts,
) {
    step_gaussians(model, moments, gradients, sizes, counts);
    let [correction1, correction2] = counts.corrections(FieldGroup::Material);
    let globals = model.prototypes.iter_mut().map(|p| (p, sizes.prototypes));
    let globals = globals.chain(model.env_raw.iter_mut().map(|p| (p, sizes.environment)));
    let [first, second] = &mut moments.globals;
    let by_globals = gradients.prototypes.iter().chain(&gradients.env_raw);
    for (((p, rate), (m, v)), g) in globals.zip(first.iter_mut().zip(second)).zip(by_globals) {
        if rate > 0.0 {
            for c in 0..3 {
                p[c] -= adam(&mut m[c], &mut v[c], g[c], rate / correction1, correction2);
            }
        }
    }
}

/// One field of the Gaussians of a task.
struct FieldSlice<'a> {
    data: &'a mut [f32],
    moments: [&'a mut [f32]; 2],
    /// Range of the field in a gradient row.
    range: Range<usize>,
    rate: f32,
    field: Field,
    correction2: f32,
}

/// Updates the Gaussians' fields. A task updates all fields of its Gaussians, so that their gradients stay in the cache.
fn step_gaussians(
    model: &mut Model,
    moments: &mut Moments,
    gradients: &Gradients,
    sizes: &StepSizes,
    counts: StepCounts,
) {
    let layout = gradients.layout;
    let tasks = model.gaussians.len().div_ceil(CHUNK);
    let mut parts: Vec<Vec<FieldSlice<'_>>> = (0..tasks).map(|_| Vec::new()).collect();
    let fields = moments.first.fields_mut().zip(moments.second.fields_mut());
    for ((field, width, data), ((_, _, first), (_, _, second))) in model.gaussians.fields_mut().zip(fields) {
        let [correction1, correction2] = counts.corrections(FieldGroup::of(field));
        let (rate, range) = (sizes.fields[field as usize] / correction1, layout.range(field));
        if rate == 0.0 || range.is_empty() {
            continue;
        }
        let [data, first, second] = [data, first, second].map(|values| values.chunks_mut(CHUNK * width));
        for (parts, (data, (first, second))) in parts.iter_mut().zip(data.zip(first.zip(second))) {
            let (moments, range) = ([first, second], range.clone());
            parts.push(FieldSlice { data, moments, range, rate, field, correction2 });
        }
    }
    let tasks = parts.into_par_iter().zip(gradients.rows.par_chunks(CHUNK * layout.row));
    tasks.for_each_init(Vec::new, |scratch, (parts, rows)| {
        for part in parts {
            let rates = (0..part.range.len()).map(|k| part.rate * share_of_step(part.field, k));
            let rates: Vec<f32> = rates.collect();
            scratch.clear();
            for row in rows.chunks_exact(layout.row) {
                scratch.extend(row[part.range.clone()].iter().copied().zip(rates.iter().copied()));
            }
            adam_all(part.data, part.moments, scratch, part.correction2);
        }
    });
}

/// [`adam`] on every parameter of `data`, from `(gradient, rate)` pairs.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
fn adam_all(data: &mut [f32], [first, second]: [&mut [f32]; 2], steps: &[(f32, f32)], correction2: f32) {
    let moments = first.iter_mut().zip(second);
    for ((p, (m, v)), (g, rate)) in data.iter_mut().zip(moments).zip(steps) {
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
