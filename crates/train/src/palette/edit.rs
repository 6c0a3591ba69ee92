//! Changes of single materials.

use relume_scene::{Field, Model, srgb};
use relume_spec::rendering::MaterialEdit;

use super::regroup::{first_fault, regrouped};
use super::{Material, OneGaussian, materials, mixed};

/// Greatest factor of an albedo by a colour. Where a material must become brighter than that, the difference is added: a factor would
/// amplify the noise of a dark material.
const MAX_FACTOR: f32 = 8.0;
/// Least share of changed materials in a Gaussian that changes.
const MIN_SHARE: f32 = 1e-4;
/// Least distance of roughness and metalness from 0 and 1, whose logits are infinite.
const MARGIN: f32 = 1e-4;

/// Why a model cannot be changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum EditError {
    /// The model has no material of this number.
    #[error("the model has the materials 0 to {last}, not {material}")]
    NoSuchMaterial {
        /// The number.
        material: u32,
        /// The last number.
        last: usize,
    },
    /// The model has no materials.
    #[error("the model has no materials")]
    NoMaterials,
    /// A split of a model with as many materials as possible.
    #[error("the model would have more than {most} materials")]
    TooManyMaterials {
        /// Most materials of a model.
        most: usize,
    },
}

/// What becomes of one material.
#[derive(Debug, Clone, Copy)]
struct Change {
    /// Factor and summand of the albedo.
    factor: [f32; 3],
    summand: [f32; 3],
    roughness: Option<f32>,
    metalness: Option<f32>,
}

impl Change {
    const NONE: Self = Self { factor: [1.0; 3], summand: [0.0; 3], roughness: None, metalness: None };

    /// The change with another edit after it. `material` is the material before all changes.
    fn then(self, edit: &MaterialEdit, material: &Material) -> Self {
        let mut change = self;
        if let Some(colour) = edit.colour {
            for (c, level) in colour.0.into_iter().enumerate() {
                let wanted = srgb::decode(f32::from(level) / 255.0);
                let mean = material.albedo[c];
                change.factor[c] = if mean > 0.0 { (wanted / mean).min(MAX_FACTOR) } else { 0.0 };
                change.summand[c] = wanted - mean * change.factor[c];
            }
        }
        if let Some(scale) = edit.scale {
            change.factor.iter_mut().chain(&mut change.summand).for_each(|value| *value *= scale);
        }
        change.roughness = edit.roughness.or(change.roughness);
        change.metalness = edit.metalness.or(change.metalness);
        change
    }
}

/// The model with changed materials; `model` stays. Merges and splits come first, in their order. Later changes of a material follow
/// earlier ones. A Gaussian of several materials changes by the share of each. A changed material without Gaussians has no effect.
///
/// # Errors
/// If the model has no materials, or none of a number in `edits`, or if a split would make too many.
pub fn edited(model: &Model, edits: &[MaterialEdit]) -> Result<Model, EditError> {
    if edits.is_empty() {
        return Ok(model.clone());
    }
    if !model.has_materials() {
        return Err(EditError::NoMaterials);
    }
    if let Some((_, _, error)) = first_fault(model.prototypes.len(), edits) {
        return Err(error);
    }
    let model = regrouped(model, edits);
    let materials = materials(&model);
    let mut changes: Vec<Option<Change>> = vec![None; materials.len()];
    for edit in edits.iter().filter(|edit| !edit.is_regrouping()) {
        let k = edit.material as usize;
        changes[k] = Some(changes[k].unwrap_or(Change::NONE).then(edit, &materials[k]));
    }
    let mut out = model.clone();
    for i in 0..model.gaussians.len() {
        apply(&model, &changes, i, &mut out);
    }
    Ok(out)
}

/// Changes Gaussian `i` of `out`. The prototypes stay; the residual has the difference.
fn apply(model: &Model, changes: &[Option<Change>], i: usize, out: &mut Model) {
    let gaussian = OneGaussian::of(model, i);
    let changed = || gaussian.shares.iter().zip(changes).filter_map(|(s, change)| Some((*s, (*change)?)));
    if changed().map(|(share, _)| share).sum::<f32>() < MIN_SHARE {
        return;
    }
    let without_residual = mixed(&gaussian.shares, &model.prototypes, &[0.0; 3]);
    let residual = out.gaussians.row_mut(Field::Residual, i);
    for c in 0..3 {
        let difference: f32 = changed()
            .map(|(share, change)| {
                share * ((change.factor[c] - 1.0) * gaussian.albedo[c] + change.summand[c])
            })
            .sum();
        residual[c] = gaussian.albedo[c] + difference - without_residual[c];
    }
    let values = [
        (
            Field::RoughLogit,
            gaussian.roughness,
            changed().filter_map(|(s, change)| Some((s, change.roughness?))).collect(),
        ),
        (
            Field::MetalLogit,
            gaussian.metalness,
            changed().filter_map(|(s, change)| Some((s, change.metalness?))).collect(),
        ),
    ];
    for (field, value, wanted) in values {
        let wanted: Vec<(f32, f32)> = wanted;
        if !wanted.is_empty() {
            let difference: f32 = wanted.iter().map(|(share, wanted)| share * (wanted - value)).sum();
            out.gaussians.row_mut(field, i)[0] = logit(value + difference);
        }
    }
}

fn logit(value: f32) -> f32 {
    let value = value.clamp(MARGIN, 1.0 - MARGIN);
    (value / (1.0 - value)).ln()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::palette::mask;
    use relume_scene::Gaussians;
    use relume_spec::rendering::Colour;

    /// Ten Gaussians: six red ones, the first with a residual, and four blue ones.
    fn model() -> Model {
        let mut g = Gaussians::zeroed(10, 2, 0, 0);
        for i in 0..10 {
            let scores = if i < 6 { [30.0, 0.0] } else { [0.0, 30.0] };
            g.row_mut(Field::ProtoLogits, i).copy_from_slice(&scores);
        }
        g.row_mut(Field::Residual, 0).copy_from_slice(&[0.12, 0.06, 0.0]);
        Model::new(g, vec![[0.4, 0.1, 0.1], [0.1, 0.1, 0.6]], vec![[0.0; 3]; 2], (2, 1))
    }

    fn near(a: f32, b: f32) -> bool {
        (a - b).abs() < 2e-4
    }

    #[test]
    fn materials_have_their_means_and_shares() {
        let found = materials(&model());
        assert!(near(found[0].share, 0.6) && near(found[1].share, 0.4), "{found:?}");
        assert!(near(found[0].albedo[0], 0.42) && near(found[0].albedo[1], 0.11), "{found:?}");
        assert!(near(found[1].albedo[2], 0.6) && near(found[1].roughness, 0.5), "{found:?}");
    }

    #[test]
    fn a_colour_is_the_mean_and_the_others_stay() {
        let (model, wanted) = (model(), [0x22, 0x44, 0x88]);
        let edit =
            MaterialEdit { colour: Some(Colour(wanted)), roughness: Some(0.2), ..MaterialEdit::default() };
        let changed = edited(&model, &[edit]).expect("material 0 exists");
        let found = materials(&changed);
        for c in 0..3 {
            assert!(near(found[0].albedo[c], srgb::decode(f32::from(wanted[c]) / 255.0)), "{found:?}");
        }
        assert!(near(found[0].roughness, 0.2) && near(found[1].roughness, 0.5), "{found:?}");
        let texture = |i: usize| OneGaussian::of(&changed, i).albedo;
        assert!(
            near(texture(0)[0] / texture(1)[0], 1.3),
            "the texture stays: {:?}, {:?}",
            texture(0),
            texture(1)
        );
        for i in 6..10 {
            assert_eq!(changed.gaussians.row(Field::Residual, i), model.gaussians.row(Field::Residual, i));
        }
        assert_eq!(edited(&model, &[]), Ok(model.clone()));
        let twice = MaterialEdit { scale: Some(2.0), ..MaterialEdit::default() };
        let again = materials(&edited(&model, &[edit, twice]).expect("material 0 exists"));
        assert!(near(again[0].albedo[2], 2.0 * found[0].albedo[2]), "{again:?}");
    }

    #[test]
    fn a_dark_material_becomes_bright_without_amplified_noise() {
        let mut model = model();
        model.prototypes[0] = [0.001; 3];
        let edit = MaterialEdit { colour: Some(Colour([255; 3])), ..MaterialEdit::default() };
        let changed = edited(&model, &[edit]).expect("material 0 exists");
        // Their albedos differed by 0.12, which the largest factor makes 0.96.
        let [first, second] = [0, 1].map(|i| OneGaussian::of(&changed, i).albedo[0]);
        assert!(first >= second && second > 0.7, "{first}, {second}");
    }

    #[test]
    fn unknown_materials_are_refused_and_a_mask_shows_one_material() {
        let edit = MaterialEdit { material: 2, scale: Some(1.0), ..MaterialEdit::default() };
        assert_eq!(edited(&model(), &[edit]), Err(EditError::NoSuchMaterial { material: 2, last: 1 }));
        let mask = mask(model(), 1).expect("material 1 exists");
        assert!(
            near(OneGaussian::of(&mask, 0).albedo[0], 0.0) && near(OneGaussian::of(&mask, 9).albedo[2], 1.0)
        );
    }
}
