//! Which materials the pixels of a frame show.

use crate::palette::shares;
use crate::render::cryptomatte::{RANKS, id};
use relume_engine::{HostModel, RasterCamera};
use relume_scene::Output;

/// Materials that one pass of the engine blends.
const PER_PASS: usize = 3;

/// The share of each material in what a pixel shows; all 0 in an empty pixel.
struct MaterialShares {
    /// For each pass, the shares of its materials by pixel.
    passes: Vec<Vec<[f32; PER_PASS]>>,
    materials: usize,
}

impl MaterialShares {
    fn of(host: &HostModel, view: RasterCamera) -> Self {
        let (model, materials) = (host.model(), host.model().prototypes.len());
        let of_gaussians: Vec<Vec<f32>> =
            (0..model.gaussians.len()).map(|i| shares(&model.gaussians, i)).collect();
        let pass = |first: usize| {
            let row = |shares: &Vec<f32>| {
                std::array::from_fn(|k| shares.get(first + k).copied().unwrap_or_default())
            };
            host.blended(view, &of_gaussians.iter().map(row).collect::<Vec<[f32; PER_PASS]>>())
        };
        Self { passes: (0..materials).step_by(PER_PASS).map(pass).collect(), materials }
    }

    /// Materials and shares of a pixel, the largest share first; equal shares in the order of their numbers.
    fn ranked(&self, pixel: usize) -> Vec<(usize, f32)> {
        let share = |k: usize| (k, self.passes[k / PER_PASS][pixel][k % PER_PASS]);
        let mut ranked: Vec<_> = (0..self.materials).map(share).filter(|(_, share)| *share > 0.0).collect();
        ranked.sort_by(|(_, a), (_, b)| b.total_cmp(a));
        ranked
    }
}

/// Those of `outputs` that show materials, as `view` shows `host` with the coverage `alpha`.
pub(super) fn material_planes(
    host: &HostModel,
    view: RasterCamera,
    alpha: &[f32],
    outputs: &[Output],
) -> Vec<(Output, Vec<f32>)> {
    let outputs: Vec<Output> = outputs.iter().copied().filter(|output| output.is_of_materials()).collect();
    if outputs.is_empty() {
        return Vec::new();
    }
    let shares = MaterialShares::of(host, view);
    let plane = |output: Output| {
        let mut values = Vec::with_capacity(alpha.len() * output.channels());
        for (pixel, alpha) in alpha.iter().enumerate() {
            let ranked = shares.ranked(pixel);
            match output {
                Output::MaterialId => {
                    values.push(ranked.first().map_or(-1.0, |(material, _)| *material as f32));
                }
                _ => values.extend_from_slice(cryptomatte(&ranked, *alpha).as_flattened()),
            }
        }
        (output, values)
    };
    outputs.into_iter().map(plane).collect()
}

/// Identifier and coverage of each rank; zeros for ranks without a material.
fn cryptomatte(ranked: &[(usize, f32)], alpha: f32) -> [[f32; 2]; RANKS] {
    let mut ranks = [[0.0; 2]; RANKS];
    for (rank, (material, share)) in ranks.iter_mut().zip(ranked) {
        *rank = [id(*material), share * alpha];
    }
    ranks
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::DVec3;

    use super::*;
    use relume_scene::{Camera, Field, Gaussians, Model};

    /// Two opaque discs side by side, the left one of material 3, the right one of two thirds material 0 and one third material 1.
    fn host() -> HostModel {
        let mut g = Gaussians::zeroed(2, 4, 0, 0);
        for (i, y) in [-0.4, 0.4].into_iter().enumerate() {
            g.row_mut(Field::Mean, i)[1] = y;
            g.row_mut(Field::LogScale, i).copy_from_slice(&[0.01f32.ln(), 0.12f32.ln(), 0.12f32.ln()]);
            g.row_mut(Field::Quaternion, i)[0] = 1.0;
            g.row_mut(Field::OpacityLogit, i)[0] = 5.0;
        }
        g.row_mut(Field::ProtoLogits, 0).copy_from_slice(&[-50.0, -50.0, -50.0, 0.0]);
        g.row_mut(Field::ProtoLogits, 1).copy_from_slice(&[2.0f32.ln(), 0.0, -50.0, -50.0]);
        HostModel::new(Arc::new(Model::new(g, vec![[0.5; 3]; 4], vec![[0.5; 3]; 8], (4, 2))))
    }

    #[test]
    fn pixels_name_their_materials_by_share() {
        let host = host();
        let camera = Camera::look_at(DVec3::X * 4.0, DVec3::ZERO, DVec3::Z, 0.5, (48, 40)).unwrap();
        let view = RasterCamera::new(&camera, &host.model().shading);
        let alpha = vec![0.5; 48 * 40];
        let outputs = [Output::Rgb, Output::MaterialId, Output::Cryptomatte];
        let planes = material_planes(&host, view, &alpha, &outputs);
        let [(Output::MaterialId, ids), (Output::Cryptomatte, ranks)] = planes.as_slice() else { panic!() };
        let (left, right) = (20 * 48 + 14, 20 * 48 + 33);
        assert_eq!([ids[0], ids[left], ids[right]], [-1.0, 3.0, 0.0]);
        let ranks = |pixel: usize| &ranks[12 * pixel..][..12];
        assert_eq!(ranks(0), [0.0; 12]);
        assert_eq!(ranks(left)[0], id(3));
        assert!((ranks(left)[1] - 0.5).abs() < 1e-3, "the coverage counts");
        let [first, first_share, second, second_share] = *ranks(right).first_chunk().unwrap();
        assert_eq!([first, second], [id(0), id(1)]);
        let errors = [first_share - 1.0 / 3.0, second_share - 1.0 / 6.0];
        assert!(errors.iter().all(|error| error.abs() < 1e-3), "{errors:?}");
        assert!(material_planes(&host, view, &alpha, &[Output::Rgb]).is_empty(), "the control");
    }
}
