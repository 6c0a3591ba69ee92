//! The materials of a model: albedo prototypes with the Gaussians that use them, and changes of single materials.
//!
//! Gaussian i belongs to material k with the share `s_ik = softmax(scores_i)_k` (docs/MODEL.md, section 1).

mod edit;
mod regroup;

pub use edit::{EditError, edited};
pub use regroup::first_fault;

use relume_engine::{sigmoid, softmax};
use relume_scene::{Field, Gaussians, Model};

/// A material of a model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Mean albedo, linear Rec.709.
    pub albedo: [f32; 3],
    /// Share of the surface of the model, 0 to 1. The shares of all materials add up to 1.
    pub share: f32,
    /// Mean roughness, 0 to 1.
    pub roughness: f32,
    /// Mean metalness, 0 to 1.
    pub metalness: f32,
}

/// The materials of a model in the order of their numbers. Gaussians count with opacity times the area of their broadest side, if a
/// photograph shows them. A material without Gaussians has the colour of its prototype and the share 0.
pub fn materials(model: &Model) -> Vec<Material> {
    let g = &model.gaussians;
    // Weight; then the sums of albedo, roughness and metalness.
    let mut sums = vec![[0.0f64; 6]; g.prototypes()];
    for gaussian in (0..g.len()).filter(|i| g.is_photographed(*i)).map(|i| OneGaussian::of(model, i)) {
        let [r, b, c] = gaussian.albedo;
        let values = [1.0, r, b, c, gaussian.roughness, gaussian.metalness];
        for (sum, share) in sums.iter_mut().zip(&gaussian.shares) {
            let weight = gaussian.weight * f64::from(*share);
            sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * f64::from(value));
        }
    }
    let whole: f64 = sums.iter().map(|sum| sum[0]).sum();
    let material = |(sum, prototype): (&[f64; 6], &[f32; 3])| {
        let mean = |k: usize| (sum[k] / sum[0]) as f32;
        if sum[0] > 0.0 {
            let share = (sum[0] / whole) as f32;
            Material { albedo: [mean(1), mean(2), mean(3)], share, roughness: mean(4), metalness: mean(5) }
        } else {
            Material {
                albedo: prototype.map(|a| a.clamp(0.0, 1.0)),
                share: 0.0,
                roughness: 0.5,
                metalness: 0.0,
            }
        }
    };
    sums.iter().zip(&model.prototypes).map(material).collect()
}

/// A model whose albedo is the share of one material, 1 where a surface has only this material. Its output `albedo` is a mask.
///
/// # Errors
/// If the model has no materials, or none of this number.
pub fn mask(mut model: Model, material: u32) -> Result<Model, EditError> {
    let k = index(&model, material)?;
    model.gaussians.field_mut(Field::Residual).fill(0.0);
    model
        .prototypes
        .iter_mut()
        .enumerate()
        .for_each(|(i, albedo)| *albedo = [f32::from(u8::from(i == k)); 3]);
    Ok(model)
}

/// Index of a material.
fn index(model: &Model, material: u32) -> Result<usize, EditError> {
    if !model.has_materials() {
        return Err(EditError::NoMaterials);
    }
    let last = model.prototypes.len().saturating_sub(1);
    let missing = EditError::NoSuchMaterial { material, last };
    usize::try_from(material).ok().filter(|k| *k < model.prototypes.len()).ok_or(missing)
}

/// The material of one Gaussian.
struct OneGaussian {
    /// Opacity times the area of the broadest side.
    weight: f64,
    /// Shares of the materials.
    shares: Vec<f32>,
    albedo: [f32; 3],
    roughness: f32,
    metalness: f32,
}

impl OneGaussian {
    fn of(model: &Model, i: usize) -> Self {
        let g = &model.gaussians;
        let mut scales = g.get::<3>(Field::LogScale, i).map(|s| f64::from(s).exp());
        scales.sort_by(f64::total_cmp);
        let shares = shares(g, i);
        let albedo = mixed(&shares, &model.prototypes, &g.get::<3>(Field::Residual, i));
        let of_logit = |field| sigmoid(g.row(field, i)[0]);
        Self {
            weight: f64::from(of_logit(Field::OpacityLogit)) * scales[1] * scales[2],
            shares,
            albedo: albedo.map(|a| a.clamp(0.0, 1.0)),
            roughness: of_logit(Field::RoughLogit),
            metalness: of_logit(Field::MetalLogit),
        }
    }
}

/// Shares of the materials in Gaussian `i`.
pub(crate) fn shares(g: &Gaussians, i: usize) -> Vec<f32> {
    let mut shares = vec![0.0; g.prototypes()];
    softmax(g.row(Field::ProtoLogits, i), &mut shares);
    shares
}

/// Albedo before its last clamp (Eq. 23).
fn mixed(shares: &[f32], prototypes: &[[f32; 3]], residual: &[f32; 3]) -> [f32; 3] {
    std::array::from_fn(|c| {
        residual[c] + shares.iter().zip(prototypes).map(|(s, a)| s * a[c].clamp(0.0, 1.0)).sum::<f32>()
    })
}
