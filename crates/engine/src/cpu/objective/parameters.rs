//! Terms on the parameters themselves: residual, flatness, the light, visibility labels.

use rayon::prelude::*;

use crate::Gradients;
use crate::cpu::objective::{sign, sum};
use crate::cpu::{self, MAX_COEFFICIENTS, Pass};
use crate::objective::{LightWeights, upward_share};
use relume_layout::constants::{LABEL_MARGIN, MIN_LABEL_WEIGHT, SIGMOID_MARGIN};
use relume_scene::light::{LUMINANCE, LightColour, UPWARD_LUMINANCE, luminance, sh_eval};
use relume_scene::{Field, Gaussians, VisibilityForm};

/// `mean sum |eps|` (Eq. 25); adds its gradient, returns its value.
pub fn residual(g: &Gaussians, weight: f32, out: &mut Gradients) -> f32 {
    let scale = weight / g.len().max(1) as f32;
    let layout = out.layout;
    let residuals = g.field(Field::Residual).par_chunks(3);
    let rows = out.rows.par_chunks_mut(layout.row).zip(residuals).with_min_len(1024);
    let values: Vec<f32> = rows
        .map(|(row, eps)| {
            row[layout.range(Field::Residual)].iter_mut().zip(eps).for_each(|(o, e)| *o += scale * sign(*e));
            eps.iter().map(|e| scale * e.abs()).sum()
        })
        .collect();
    sum(&values)
}

/// Mean deviation of each texel's channels from their mean (Eq. 31): `(value, gradient by radiance)`.
pub fn light_neutrality(radiance: &[[f32; 3]], weight: f32) -> (f32, Vec<[f32; 3]>) {
    let scale = weight / (3 * radiance.len()).max(1) as f32;
    let mut total = 0.0f64;
    let gradient = radiance
        .iter()
        .map(|l| {
            let mean = (l[0] + l[1] + l[2]) / 3.0;
            let sign = l.map(|v| sign(v - mean));
            total += f64::from(scale) * (0..3).map(|c| f64::from((l[c] - mean).abs())).sum::<f64>();
            let shared = (sign[0] + sign[1] + sign[2]) / 3.0;
            sign.map(|s| scale * (s - shared))
        })
        .collect();
    (total as f32, gradient)
}

/// `mean |c - label|^2 / 4 pi`: the mean squared visibility error over the sphere (Parseval).
pub fn probe_labels(g: &Gaussians, labels: &[f32], weight: f32, out: &mut Gradients) -> f32 {
    let width = g.width(Field::Visibility);
    if labels.len() != g.len() * width || g.is_empty() {
        return 0.0;
    }
    let scale = weight / (g.len() as f32 * 4.0 * std::f32::consts::PI);
    let layout = out.layout;
    let pairs = g.field(Field::Visibility).par_chunks_exact(width).zip(labels.par_chunks_exact(width));
    let rows = out.rows.par_chunks_mut(layout.row).zip(pairs).with_min_len(512);
    let values: Vec<f32> = rows
        .map(|(row, (c, label))| {
            let mut value = 0.0;
            for ((o, c), l) in row[layout.range(Field::Visibility)].iter_mut().zip(c).zip(label) {
                value += scale * (c - l) * (c - l);
                *o += 2.0 * scale * (c - l);
            }
            value
        })
        .collect();
    sum(&values)
}

/// BCE of the visibility towards the continuing view direction against backward transmittance (Eq. 15): the mean over
/// Gaussians with weight. Adds its gradient, returns its value.
pub fn backward_labels(
    g: &Gaussians,
    pass: &Pass,
    form: VisibilityForm,
    weight: f32,
    out: &mut Gradients,
) -> f32 {
    let sigmoid_form = form == VisibilityForm::Sigmoid;
    let labels = cpu::backward_labels(pass);
    let counted = labels.iter().filter(|l| l.weight > MIN_LABEL_WEIGHT).count();
    let scale = weight / counted.max(1) as f32;
    let (sh_degree, width) = (g.visibility_degree(), g.width(Field::Visibility));
    let layout = out.layout;
    let mut total = 0.0f64;
    for (splat, label) in pass.splats.iter().zip(&labels).filter(|(_, l)| l.weight > MIN_LABEL_WEIGHT) {
        let i = splat.gaussian as usize;
        let mean: [f32; 3] = g.get(Field::Mean, i);
        let (direction, _) = cpu::normalise(std::array::from_fn(|k| mean[k] - pass.view.centre[k]));
        let mut y = [0.0f32; MAX_COEFFICIENTS];
        sh_eval(sh_degree, direction, &mut y);
        let raw: f32 = g.row(Field::Visibility, i).iter().zip(&y).map(|(c, y)| c * y).sum();
        let p = label.transmittance;
        let (v, by_raw) = if sigmoid_form {
            // BCE with logits: the derivative by the logit is V - p.
            let v = crate::sigmoid(raw).clamp(SIGMOID_MARGIN, 1.0 - SIGMOID_MARGIN);
            (v, v - p)
        } else {
            let v = raw.clamp(LABEL_MARGIN, 1.0 - LABEL_MARGIN);
            let derivative = (1.0 - p) / (1.0 - v) - p / v;
            // Outside the margin only a derivative that leads back inside passes.
            let leads_away = (raw < v && derivative > 0.0) || (raw > v && derivative < 0.0);
            (v, if leads_away { 0.0 } else { derivative })
        };
        total -= f64::from(scale * (p * v.ln() + (1.0 - p) * (1.0 - v).ln()));
        let by_v = scale * by_raw;
        let row = &mut out.rows[i * layout.row..][layout.range(Field::Visibility)];
        row.iter_mut().zip(&y[..width]).for_each(|(o, y)| *o += by_v * y);
    }
    total as f32
}

/// `mean smallest standard deviation`: adds its gradient, returns its value.
pub fn flatness(g: &Gaussians, weight: f32, out: &mut Gradients) -> f32 {
    let scale = weight / g.len().max(1) as f32;
    let layout = out.layout;
    let scales = g.field(Field::LogScale).par_chunks(3);
    let rows = out.rows.par_chunks_mut(layout.row).zip(scales).with_min_len(1024);
    let values: Vec<f32> = rows
        .map(|(row, s)| {
            let axis = if s[0] <= s[1] && s[0] <= s[2] {
                0
            } else if s[1] <= s[2] {
                1
            } else {
                2
            };
            let term = scale * s[axis].exp();
            row[layout.range(Field::LogScale)][axis] += term;
            term
        })
        .collect();
    sum(&values)
}

/// `weight ln(Y / (pi Y'))^2`: Y is the luminance of the irradiance of a surface facing up, Y' the luminance of a white one in
/// a well-exposed photograph. The term fixes the scale, which light and albedo could trade. `(value, gradient by radiance)`.
pub fn exposure(radiance: &[[f32; 3]], texels: &[(glam::DVec3, f64)], weight: f32) -> (f32, Vec<[f32; 3]>) {
    let up: f32 = radiance.iter().zip(texels).map(|(l, t)| upward_share(t) * luminance(*l)).sum();
    let log = (up.max(1e-6) / UPWARD_LUMINANCE).ln();
    let by_up = LUMINANCE.map(|share| 2.0 * weight * log * share / up.max(1e-6));
    (weight * log * log, texels.iter().map(|t| by_up.map(|g| g * upward_share(t))).collect())
}

/// `colour (t(b - b')^2 + t(g - g')^2)`: (b, g) is the [`LightColour`] of the irradiance of a surface facing up, (b', g') the
/// `wanted` one, t the part beyond the tolerance. The term fixes the colour, which light and albedo could trade. `(value, gradient by radiance)`.
pub fn light_colour(
    radiance: &[[f32; 3]],
    texels: &[(glam::DVec3, f64)],
    weights: &LightWeights,
) -> (f32, Vec<[f32; 3]>) {
    let up: [f32; 3] = std::array::from_fn(|c| {
        radiance.iter().zip(texels).map(|(l, t)| upward_share(t) * l[c]).sum::<f32>().max(1e-6)
    });
    let found = LightColour::of(up);
    let (weight, wanted) = (weights.colour, weights.wanted);
    let blue = weights.beyond_tolerance(found.blue_over_red - wanted.blue_over_red);
    let green = weights.beyond_tolerance(found.green - wanted.green);
    let by_log = [-blue - green, 2.0 * green, blue - green];
    let by_up: [f32; 3] = std::array::from_fn(|c| 2.0 * weight * by_log[c] / up[c]);
    let value = weight * (blue * blue + green * green);
    (value, texels.iter().map(|t| by_up.map(|g| g * upward_share(t))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_colour_term_penalises_only_the_colour_of_the_light() {
        let texels = relume_scene::texel_directions(8, 4);
        let wanted = LightColour::of([0.8, 0.94, 1.26]);
        let weights = |tolerance| LightWeights { colour: 1.0, wanted, tolerance, ..LightWeights::default() };
        let value = |light: [f32; 3]| light_colour(&[light; 32], &texels, &weights(0.0)).0;
        assert!(value([0.8, 0.94, 1.26]) < 1e-12);
        assert!(value([2.4, 2.82, 3.78]) < 1e-12, "its level is the exposure term's");
        let expected = wanted.blue_over_red.powi(2) + wanted.green.powi(2);
        assert!((value([1.0; 3]) - expected).abs() < 1e-5);
        let warm: Vec<[f32; 3]> = (0..32).map(|i| [1.0, 0.7, 0.2 + 0.01 * i as f32]).collect();
        let gradient = light_colour(&warm, &texels, &weights(0.1)).1;
        for (t, c) in [(0, 0), (3, 2), (9, 0), (9, 1), (9, 2)] {
            let at = |step: f32| {
                let mut moved = warm.clone();
                moved[t][c] += step;
                light_colour(&moved, &texels, &weights(0.1)).0
            };
            let numeric = (at(1e-2) - at(-1e-2)) / 2e-2;
            assert!((numeric - gradient[t][c]).abs() < 2e-3, "{t} {c}: {numeric} {}", gradient[t][c]);
        }
        let near = [0.8, 0.94, 1.2];
        assert!(value(near) > 1e-3);
        assert_eq!(light_colour(&[near; 32], &texels, &weights(0.1)).0, 0.0, "within the tolerance");
        assert!(gradient[9][2] < -1e-3 && gradient[9][0] > 1e-3, "a warm light is told to be bluer");
    }

    #[test]
    fn neutrality_term_is_zero_for_grey_and_positive_for_red_light() {
        assert_eq!(light_neutrality(&[[0.4; 3]; 5], 1.0).0, 0.0);
        let (value, gradient) = light_neutrality(&[[1.0, 0.0, 0.0]], 1.0);
        assert!(value > 0.3 && gradient[0][0] > 0.0 && gradient[0][1] < 0.0);
    }
}
