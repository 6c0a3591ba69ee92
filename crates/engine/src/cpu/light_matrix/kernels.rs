//! Sums over lobes: each kernel adds to one number per lobe.

use std::ops::Range;

use multiversion::multiversion;

use relume_scene::light::{LobeTables, Taps};

/// Adds the irradiance at the normal of `taps` through the visibility `coefficients`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn add_irradiance(
    tables: &LobeTables,
    taps: &Taps<f32>,
    coefficients: &[f32],
    lobes: &Range<usize>,
    out: &mut [f32],
) {
    for (node, weight) in taps.node.into_iter().zip(taps.weight) {
        for (j, coefficient) in coefficients.iter().enumerate() {
            let factor = weight * coefficient;
            let row = tables.diffuse(node, j, lobes);
            out.iter_mut().zip(row).for_each(|(sum, light)| *sum += factor * light);
        }
    }
}

/// Adds `factor` times the prefiltered radiance of a level at the direction of `taps`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn add_prefiltered(
    tables: &LobeTables,
    (level, factor): (usize, f32),
    taps: &Taps<f32>,
    lobes: &Range<usize>,
    out: &mut [f32],
) {
    for (node, weight) in taps.node.into_iter().zip(taps.weight) {
        let factor = factor * weight;
        let row = tables.specular(level, node, lobes);
        out.iter_mut().zip(row).for_each(|(sum, light)| *sum += factor * light);
    }
}

/// Adds the products of `factors`, one per direction, and `light`, a row of lobes per direction.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn add_directions(factors: &[i16], light: &[f32], out: &mut [f32]) {
    let width = out.len().max(1);
    for (factor, row) in factors.iter().zip(light.chunks_exact(width)) {
        if *factor != 0 {
            let factor = f32::from(*factor);
            out.iter_mut().zip(row).for_each(|(sum, light)| *sum += factor * light);
        }
    }
}

/// Adds `factor` times `row`.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx512bw+fma", "x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn add_scaled(factor: f32, row: &[f32], out: &mut [f32]) {
    out.iter_mut().zip(row).for_each(|(sum, value)| *sum += factor * value);
}
