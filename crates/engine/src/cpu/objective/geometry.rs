//! Terms on the G-buffer: depth-normal consistency and edge-aware smoothness.

use rayon::prelude::*;

use crate::cpu::objective::sign;
use crate::cpu::{BufferGradient, Pass, normalise, normalise_backward};
use relume_layout::channel;
use relume_layout::constants::{MAX_DEPTH_STEP, MIN_COVERAGE, TRUSTED_COVERAGE};

type Vec3 = [f32; 3];

fn sub(a: Vec3, b: Vec3) -> Vec3 {
    std::array::from_fn(|k| a[k] - b[k])
}
fn dot(a: Vec3, b: Vec3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Depth of the pixel's plane: `t = D / (N . ray)` along the unnormalised ray (z_c = 1), or `None`.
fn plane_depth(pass: &Pass, x: usize, y: usize) -> Option<f32> {
    if pass.at(x, y, channel::COVERAGE) < TRUSTED_COVERAGE {
        return None;
    }
    let n: Vec3 = std::array::from_fn(|k| pass.at(x, y, channel::NORMAL.start + k));
    let facing = dot(n, pass.view.ray(x, y));
    let t = pass.at(x, y, channel::PLANE) / facing;
    // Grazing planes have no usable depth.
    (facing < -0.05 && t > 0.0 && t < 1e4).then_some(t)
}

/// One pixel's share: `weight coverage (1 - n . n_d)` and the gradients by its own normal and three depths.
struct Consistency {
    loss: f32,
    by_normal: Vec3,
    by_coverage: f32,
    /// Gradient by the plane depth of this pixel, its right and its lower neighbour.
    by_depth: [f32; 3],
}

fn consistency(pass: &Pass, depth: &[f32], x: usize, y: usize, weight: f32) -> Option<Consistency> {
    let w = pass.view.width;
    let i = y * w + x;
    let t = [depth[i], depth[i + 1], depth[i + w]];
    if t.iter().any(|t| *t <= 0.0) || t.iter().any(|v| (v - t[0]).abs() > MAX_DEPTH_STEP * t[0]) {
        return None;
    }
    let rays = [pass.view.ray(x, y), pass.view.ray(x + 1, y), pass.view.ray(x, y + 1)];
    let point = |k: usize| rays[k].map(|r| r * t[k]);
    let (right, down) = (sub(point(1), point(0)), sub(point(2), point(0)));
    // In an OpenCV image, right x down points away from the camera.
    let (towards, length) = normalise(cross(down, right));
    let raw: Vec3 = std::array::from_fn(|k| pass.at(x, y, channel::NORMAL.start + k));
    let (normal, normal_length) = normalise(raw);
    let coverage = pass.at(x, y, channel::COVERAGE);
    let aligned = dot(normal, towards);
    let by_towards = normalise_backward(towards, length, normal.map(|v| -weight * coverage * v));
    // d (down x right): by down = right x g, by right = g x down.
    let (by_down, by_right) = (cross(right, by_towards), cross(by_towards, down));
    let by_point = [std::array::from_fn(|k| -by_down[k] - by_right[k]), by_right, by_down];
    Some(Consistency {
        loss: weight * coverage * (1.0 - aligned),
        by_normal: normalise_backward(normal, normal_length, towards.map(|v| -weight * coverage * v)),
        by_coverage: weight * (1.0 - aligned),
        by_depth: std::array::from_fn(|k| dot(by_point[k], rays[k])),
    })
}

/// Depth-normal consistency: adds its gradient to `out` and returns its value.
pub fn depth_normal(pass: &Pass, weight: f32, out: &mut [BufferGradient]) -> f32 {
    let (w, h) = (pass.view.width, pass.view.height);
    if weight == 0.0 || w < 2 || h < 2 {
        return 0.0;
    }
    let weight = weight / (w * h) as f32;
    let depth: Vec<f32> = (0..w * h)
        .into_par_iter()
        .with_min_len(1024)
        .map(|i| plane_depth(pass, i % w, i / w).unwrap_or(0.0))
        .collect();
    let terms: Vec<Option<Consistency>> = (0..w * h)
        .into_par_iter()
        .with_min_len(1024)
        .map(|i| {
            let (x, y) = (i % w, i / w);
            if x + 1 < w && y + 1 < h { consistency(pass, &depth, x, y, weight) } else { None }
        })
        .collect();
    let total: f64 = terms.iter().flatten().map(|term| f64::from(term.loss)).sum();
    // Gradient of the term `back` pixels before by its neighbour `k`, which is this pixel.
    let by_depth_of = |i: usize, back: usize, k: usize| {
        let term = i.checked_sub(back).and_then(|i| terms[i].as_ref());
        term.map_or(0.0, |term| term.by_depth[k])
    };
    out.par_iter_mut().enumerate().with_min_len(1024).for_each(|(i, o)| {
        if let Some(term) = &terms[i] {
            o.coverage += term.by_coverage;
            (0..3).for_each(|k| o.normal[k] += term.by_normal[k]);
        }
        let g = by_depth_of(i, w, 2) + by_depth_of(i, 1, 1) + by_depth_of(i, 0, 0);
        if g == 0.0 {
            return;
        }
        let (x, y) = (i % w, i / w);
        let ray = pass.view.ray(x, y);
        let n: Vec3 = std::array::from_fn(|k| pass.at(x, y, channel::NORMAL.start + k));
        let facing = dot(n, ray);
        o.plane += g / facing;
        (0..3).for_each(|k| o.normal[k] -= g * depth[i] / facing * ray[k]);
    });
    total as f32
}

/// Derivatives of one pair's `weight |b - a| exp(-edge)` by its second attributes `b`; those by `a` are the negatives.
fn pair_derivatives(
    weights: &[f32; 5],
    image_a: Vec3,
    image_b: Vec3,
    a: &[f32; 5],
    b: &[f32; 5],
) -> [f32; 5] {
    let edge: f32 = (0..3).map(|c| (image_a[c] - image_b[c]).abs()).sum::<f32>() / 3.0;
    let factor = (-edge).exp();
    std::array::from_fn(|k| factor * weights[k] * sign(b[k] - a[k]))
}

/// Edge-aware smoothness (Eq. 32) of metalness, roughness and normal, each with its weight; adds its gradient, returns
/// its value.
pub fn smoothness(pass: &Pass, image: &[[f32; 3]], weights: [f32; 3], out: &mut [BufferGradient]) -> f32 {
    let (w, h) = (pass.view.width, pass.view.height);
    if weights == [0.0; 3] || w < 2 || h < 2 {
        return 0.0;
    }
    let attributes: Vec<[f32; 5]> = (0..w * h)
        .into_par_iter()
        .with_min_len(1024)
        .map(|i| {
            let (x, y) = (i % w, i / w);
            let inverse = 1.0 / pass.at(x, y, channel::COVERAGE).max(1e-6);
            let covered = pass.at(x, y, channel::COVERAGE) >= MIN_COVERAGE;
            let keep = if covered { inverse } else { 0.0 };
            let n = channel::NORMAL.start;
            [channel::METAL, channel::ROUGH, n, n + 1, n + 2].map(|c| pass.at(x, y, c) * keep)
        })
        .collect();
    // Mean over the pairs across and down, and over the three channels of a normal.
    let [metal, rough, normal] = weights;
    let scale = [(w - 1) * h, w * (h - 1)].map(|pairs| {
        [metal, rough, normal / 3.0, normal / 3.0, normal / 3.0].map(|weight| weight / pairs as f32)
    });
    // Every pixel computes its up to four pairs itself, so that rows can run in parallel. The first pixel of a pair counts
    // its value.
    let pixel = |i: usize| -> ([f32; 5], f64) {
        let (x, y) = (i % w, i / w);
        let mut by = [0.0f32; 5];
        let mut value = 0.0;
        let mut pair = |first: usize, second: usize, weights: &[f32; 5]| {
            let derivatives = pair_derivatives(
                weights,
                image[first],
                image[second],
                &attributes[first],
                &attributes[second],
            );
            let sign = if i == first { -1.0 } else { 1.0 };
            for k in 0..5 {
                by[k] += sign * derivatives[k];
                if i == first {
                    value += f64::from(derivatives[k] * (attributes[second][k] - attributes[first][k]));
                }
            }
        };
        if y > 0 {
            pair(i - w, i, &scale[1]);
        }
        if x > 0 {
            pair(i - 1, i, &scale[0]);
        }
        if x + 1 < w {
            pair(i, i + 1, &scale[0]);
        }
        if y + 1 < h {
            pair(i, i + w, &scale[1]);
        }
        (by, value)
    };
    let found: Vec<([f32; 5], f64)> = (0..w * h).into_par_iter().with_min_len(1024).map(pixel).collect();
    let total: f64 = found.iter().map(|(_, value)| value).sum();
    out.par_iter_mut().enumerate().with_min_len(1024).for_each(|(i, o)| {
        let coverage = pass.at(i % w, i / w, channel::COVERAGE);
        if coverage < MIN_COVERAGE {
            return;
        }
        let (inverse, g, a) = (1.0 / coverage, found[i].0, attributes[i]);
        o.metal += g[0] * inverse;
        o.rough += g[1] * inverse;
        (0..3).for_each(|k| o.normal[k] += g[2 + k] * inverse);
        o.coverage -= (0..5).map(|k| g[k] * a[k]).sum::<f32>() * inverse;
    });
    total as f32
}

/// `weight mean |coverage - alpha|` against the photograph's mask; adds its gradient, returns its value.
pub fn coverage(pass: &Pass, alpha: &[f32], weight: f32, out: &mut [BufferGradient]) -> f32 {
    let w = pass.view.width;
    let scale = weight / alpha.len().max(1) as f32;
    let mut total = 0.0f64;
    for (i, (o, a)) in out.iter_mut().zip(alpha).enumerate() {
        let d = pass.at(i % w, i / w, channel::COVERAGE) - a;
        total += f64::from(scale * d.abs());
        o.coverage += scale * sign(d);
    }
    total as f32
}
