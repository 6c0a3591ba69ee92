//! What the photographs of a capture say about each Gaussian.

use std::collections::BTreeSet;

use rayon::prelude::*;

use crate::context::StepContext;
use crate::dataset::Dataset;
use crate::exposure::{reduced, reduced_camera};
use relume_engine::{PhotoSize, TrainState, evaluation};
use relume_scene::light::UNOCCLUDED_SH0;
use relume_scene::{Field, VisibilityForm};

/// Greatest number of photographs that are compared with the physically based branch.
const MAX_COMPARED: usize = 32;
/// Longest side of the images, pixels.
const SIDE: u32 = 128;

/// What the photographs say about a Gaussian.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Evidence {
    /// Number of photographs that show it, each counted by the share of its footprint that is not hidden.
    pub(super) photographs: f32,
    /// Mean absolute difference between these photographs and the physically based branch where they show it, display values.
    pub(super) residual: f32,
    /// Mean visibility over all directions, 0 to 1.
    pub(super) openness: f32,
}

/// Sums over photographs.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    shares: f32,
    weight: f32,
    weighted_residual: f32,
}

/// The evidence for each Gaussian of `state` in the photographs of `data`.
pub(super) fn evidence(state: &TrainState, context: &StepContext<'_>, data: &Dataset) -> Vec<Evidence> {
    let gaussians = &state.model.gaussians;
    let mut sums = vec![Sums::default(); gaussians.len()];
    let count = data.len().min(MAX_COMPARED);
    let compared: BTreeSet<usize> = (0..count).map(|k| k * data.len() / count).collect();
    for index in (0..data.len()).filter(|index| !compared.contains(index)) {
        let camera = reduced_camera(data.camera(index, PhotoSize::Half), SIDE);
        let shares = evaluation::visible_shares(state, &camera);
        sums.iter_mut().zip(shares).for_each(|(sums, share)| sums.shares += share.unwrap_or_default());
    }
    for index in compared {
        let photo = reduced(&data.decode_uncached(index, PhotoSize::Half), SIDE);
        let image = context.physical_image(state, &photo);
        let difference =
            |(a, b): (&[f32; 3], &[f32; 3])| (0..3).map(|c| (a[c] - b[c]).abs()).sum::<f32>() / 3.0;
        let differences: Vec<f32> = image.iter().zip(&photo.pixels).map(difference).collect();
        let shown = evaluation::shown_in(state, &photo.camera, &differences);
        sums.par_iter_mut().zip(shown).for_each(|(sums, shown)| {
            if let Some(shown) = shown {
                sums.shares += shown.share;
                sums.weight += shown.weight;
                sums.weighted_residual += shown.weight * shown.mean;
            }
        });
    }
    let of = |(i, sums): (usize, &Sums)| Evidence {
        photographs: sums.shares,
        residual: sums.weighted_residual / sums.weight.max(f32::MIN_POSITIVE),
        openness: match state.model.shading.visibility {
            VisibilityForm::Linear => {
                (gaussians.row(Field::Visibility, i)[0] / UNOCCLUDED_SH0).clamp(0.0, 1.0)
            }
            // The mean of a sigmoid of the field is not one of its coefficients.
            VisibilityForm::Sigmoid | VisibilityForm::Off => 1.0,
        },
    };
    sums.iter().enumerate().map(of).collect()
}
