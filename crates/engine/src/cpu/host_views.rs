//! Views of a model on the host that need no light.

use rayon::prelude::*;

use crate::cpu::shown_splats::{ShadedColumns, ShownSplats};
use crate::cpu::{HostModel, Pass, Splat, backward_labels, radiance_image};
use crate::{NO_INDIRECT_BASIS, RasterCamera};
use relume_layout::channel::Channels;
use relume_layout::constants::{EarlyStop, MIN_COVERAGE};

/// Floats per splat: coverage, the values, and padding to a group of channels.
const STORED: usize = 4;

impl HostModel {
    /// Means of `values`, `N` per Gaussian, over what each pixel of `view` shows, row-major; 0 in empty pixels. Gaussians without values
    /// have 0.
    pub fn blended<const N: usize>(&self, view: RasterCamera, values: &[[f32; N]]) -> Vec<[f32; N]> {
        const { assert!(N < STORED) };
        let source = self.source(&[], &[], &NO_INDIRECT_BASIS);
        let splats = ShownSplats::without_materials(&source, view);
        let row = |splat: &Splat| {
            let values = values.get(splat.gaussian as usize).copied().unwrap_or([0.0; N]);
            let mut row = [1.0, 0.0, 0.0, 0.0];
            row[1..=N].copy_from_slice(&values);
            row
        };
        let attributes = splats.splats.iter().flat_map(row).collect();
        let columns = ShadedColumns { channels: 1 + N, stored: STORED, attributes };
        let strips: Vec<Vec<f32>> =
            (0..splats.strips()).into_par_iter().map(|index| splats.strip(&columns, index)).collect();
        strips.iter().flat_map(|strip| means(strip)).collect()
    }

    /// The radiance branch as `view` shows it, display-referred over `background`, row-major.
    pub fn radiance(&self, view: RasterCamera, background: [f32; 3]) -> Vec<[f32; 3]> {
        radiance_image(&self.colours(view), background)
    }

    /// Summed blending weight of each Gaussian in `view`, pixels.
    pub fn blending_weights(&self, view: RasterCamera) -> Vec<f32> {
        let pass = self.colours(view);
        let mut out = vec![0.0; self.model().gaussians.len()];
        for (splat, label) in pass.splats.iter().zip(backward_labels(&pass)) {
            out[splat.gaussian as usize] = label.weight;
        }
        out
    }

    fn colours(&self, view: RasterCamera) -> Pass {
        let source = self.source(&[], &[], &NO_INDIRECT_BASIS);
        Pass::forward(&source, view, Channels::Colour, EarlyStop::WhenSaturated)
    }
}

/// The other channels of a strip divided by the first, its coverage.
fn means<const N: usize>(strip: &[f32]) -> impl Iterator<Item = [f32; N]> + '_ {
    let pixels = strip.len() / (1 + N);
    (0..pixels).map(move |i| {
        let coverage = strip[i];
        let mean = |c: usize| strip[(1 + c) * pixels + i] / coverage;
        if coverage > MIN_COVERAGE { std::array::from_fn(mean) } else { [0.0; N] }
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::DVec3;

    use super::*;
    use crate::TrainState;
    use crate::evaluation;
    use relume_scene::{Camera, Field, Gaussians, Model};

    /// Two opaque discs side by side, across the view along x.
    fn model() -> Model {
        let mut g = Gaussians::zeroed(2, 1, 0, 0);
        for (i, y) in [-0.4, 0.4].into_iter().enumerate() {
            g.row_mut(Field::Mean, i)[1] = y;
            g.row_mut(Field::LogScale, i).copy_from_slice(&[0.01f32.ln(), 0.12f32.ln(), 0.12f32.ln()]);
            g.row_mut(Field::Quaternion, i)[0] = 1.0;
            g.row_mut(Field::OpacityLogit, i)[0] = 5.0;
        }
        Model::new(g, vec![[0.5; 3]], vec![[0.5; 3]; 8], (4, 2))
    }

    fn camera() -> Camera {
        Camera::look_at(DVec3::X * 4.0, DVec3::ZERO, DVec3::Z, 0.5, (48, 40)).unwrap()
    }

    #[test]
    fn pixels_have_the_mean_value_of_what_they_show() {
        let host = HostModel::new(Arc::new(model()));
        let view = RasterCamera::new(&camera(), &host.model().shading);
        let planes = host.blended(view, &[[0.25, 1.0, 0.0], [0.75, 0.0, 1.0]]);
        let shares = planes[20 * 48 + 14];
        assert!((shares[1] - 1.0).abs() < 1e-3 && shares[2].abs() < 1e-3, "{shares:?}");
        let plane: Vec<f32> = planes.iter().map(|values| values[0]).collect();
        assert_eq!(plane.len(), 48 * 40);
        // The camera looks along -x with z up, so +y is on the right.
        let at = |x: usize| plane[20 * 48 + x];
        assert!((at(14) - 0.25).abs() < 1e-3 && (at(33) - 0.75).abs() < 1e-3, "{} {}", at(14), at(33));
        assert_eq!(plane[0], 0.0, "an empty pixel");
        let without = host.blended(view, &[[0.25]]).into_flattened();
        assert!(
            (without[20 * 48 + 14] - 0.25).abs() < 1e-3 && without[20 * 48 + 33] == 0.0,
            "no value counts as 0"
        );
    }

    #[test]
    fn weighted_means_are_those_of_the_pixels_of_each_gaussian() {
        let state = TrainState::new(model());
        let values: Vec<f32> = (0..48 * 40).map(|i| if i % 48 < 24 { 0.2 } else { 0.6 }).collect();
        let shown = evaluation::shown_in(&state, &camera(), &values);
        let means: Vec<f32> = shown.iter().map(|shown| shown.unwrap().mean).collect();
        assert!((means[0] - 0.2).abs() < 1e-3 && (means[1] - 0.6).abs() < 1e-3, "{means:?}");
        let weights = evaluation::blending_weights(&state, &camera());
        for (shown, weight) in shown.iter().zip(&weights) {
            assert!((shown.unwrap().weight / weight - 1.0).abs() < 1e-5);
        }
        let host = HostModel::new(Arc::new(model()));
        assert_eq!(host.blending_weights(RasterCamera::new(&camera(), &host.model().shading)), weights);
        assert!(shown.iter().all(|shown| shown.unwrap().share > 0.9));
    }
}
