//! Merges and splits of materials.

use glam::DVec3;

use super::{EditError, OneGaussian, mixed};
use relume_scene::{Field, Gaussians, Model};
use relume_spec::rendering::{Ball, MaterialEdit};

/// Score of a material of which a Gaussian has no share.
const NO_SHARE: f32 = -1e4;
/// Most materials of a model.
const MAX_MATERIALS: usize = 256;

/// The first edit that a model with `materials` materials does not allow, with the name of the faulty field.
pub fn first_fault(materials: usize, edits: &[MaterialEdit]) -> Option<(usize, &'static str, EditError)> {
    let (mut count, mut first) = (materials, None);
    let exists = |material: u32, count: usize| usize::try_from(material).is_ok_and(|k| k < count);
    let missing =
        |material: u32, count: usize| EditError::NoSuchMaterial { material, last: count.saturating_sub(1) };
    for (i, edit) in edits.iter().enumerate().filter(|(_, edit)| edit.is_regrouping()) {
        let fault = match edit.into {
            _ if !exists(edit.material, count) => Some(("material", missing(edit.material, count))),
            Some(into) if !exists(into, count) => Some(("into", missing(into, count))),
            None if count >= MAX_MATERIALS => {
                Some(("split", EditError::TooManyMaterials { most: MAX_MATERIALS }))
            }
            _ => None,
        };
        first = first.or(fault.map(|(field, error)| (i, field, error)));
        count += usize::from(edit.split.is_some());
    }
    let missing = |(i, edit): (usize, &MaterialEdit)| {
        (!exists(edit.material, count)).then(|| (i, "material", missing(edit.material, count)))
    };
    first.or_else(|| edits.iter().enumerate().find_map(missing))
}

/// The model after the merges and splits among `edits`, which [`first_fault`] allows. No surface changes its albedo.
pub(super) fn regrouped(model: &Model, edits: &[MaterialEdit]) -> Model {
    let mut out = model.clone();
    for edit in edits {
        let material = edit.material as usize;
        match (edit.into, edit.split) {
            (Some(into), _) => merge(&mut out, material, into as usize),
            (None, Some(ball)) => split(&mut out, material, ball),
            (None, None) => {}
        }
    }
    out
}

/// Moves the shares of material `from` to `into`. The residuals keep the albedo.
fn merge(model: &mut Model, from: usize, into: usize) {
    for i in 0..model.gaussians.len() {
        let before = OneGaussian::of(model, i);
        let scores = model.gaussians.row_mut(Field::ProtoLogits, i);
        let (high, low) = (scores[from].max(scores[into]), scores[from].min(scores[into]));
        // The sum of the exponentials.
        (scores[into], scores[from]) = (high + (low - high).exp().ln_1p(), NO_SHARE);
        if before.shares[from] > 0.0 {
            let shares = super::shares(&model.gaussians, i);
            let without_residual = mixed(&shares, &model.prototypes, &[0.0; 3]);
            let residual = model.gaussians.row_mut(Field::Residual, i);
            (0..3).for_each(|c| residual[c] = before.albedo[c] - without_residual[c]);
        }
    }
}

/// Moves the shares of `material` in Gaussians whose mean is in `ball` to a new material.
fn split(model: &mut Model, material: usize, ball: Ball) {
    let new = model.prototypes.len();
    let mut gaussians = with_one_more(&model.gaussians);
    let (centre, radius) = (DVec3::from_array(ball.centre), ball.radius);
    for i in 0..gaussians.len() {
        let mean = DVec3::from_array(gaussians.get::<3>(Field::Mean, i).map(f64::from));
        let place = mean / model.world_scale - model.world_offset;
        let scores = gaussians.row_mut(Field::ProtoLogits, i);
        let [from, to] = if place.distance(centre) <= radius { [new, material] } else { [material, new] };
        (scores[from], scores[to]) = (scores[material], NO_SHARE);
    }
    model.gaussians = gaussians;
    model.prototypes.push(model.prototypes[material]);
}

/// The Gaussians with scores of one more material.
fn with_one_more(g: &Gaussians) -> Gaussians {
    let mut out = Gaussians::zeroed(g.len(), g.prototypes() + 1, g.visibility_degree(), g.radiance_degree());
    for field in Field::ALL {
        if g.width(field) == out.width(field) {
            out.field_mut(field).copy_from_slice(g.field(field));
        } else {
            for i in 0..g.len() {
                out.row_mut(field, i)[..g.width(field)].copy_from_slice(g.row(field, i));
            }
        }
    }
    out.set_confidence(g.confidence().unwrap_or_default().to_vec());
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::palette::{edited, mask, materials};

    /// Eight Gaussians along x: two red ones, two mixed ones, four blue ones; their residuals differ.
    fn model() -> Model {
        let mut g = Gaussians::zeroed(8, 3, 0, 0);
        for i in 0..8 {
            let scores = [[9.0, 0.0, 0.0], [1.0, 1.5, -9.0], [0.0, 0.0, 9.0]][[0, 0, 1, 1, 2, 2, 2, 2][i]];
            g.row_mut(Field::ProtoLogits, i).copy_from_slice(&scores);
            g.row_mut(Field::Mean, i)[0] = i as f32;
            g.row_mut(Field::Residual, i)[1] = 0.02 * i as f32;
        }
        let prototypes = vec![[0.5, 0.1, 0.1], [0.7, 0.4, 0.1], [0.1, 0.1, 0.6]];
        let model = Model::new(g, prototypes, vec![[0.0; 3]; 2], (2, 1));
        Model { world_scale: 0.5, world_offset: DVec3::X, ..model }
    }

    fn of(text: &str) -> Vec<MaterialEdit> {
        text.split(',').map(|edit| edit.parse().expect(edit)).collect()
    }

    fn albedos(model: &Model) -> Vec<[f32; 3]> {
        (0..model.gaussians.len()).map(|i| OneGaussian::of(model, i).albedo).collect()
    }

    fn apart(a: &[[f32; 3]], b: &[[f32; 3]]) -> f32 {
        let differences = a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b).abs());
        differences.fold(0.0, |most, d| if d > most || d.is_nan() { d } else { most })
    }

    #[test]
    fn merged_materials_keep_colours_and_change_together() {
        let model = model();
        let merged = edited(&model, &of("1.into=0")).expect("both exist");
        assert!(apart(&albedos(&merged), &albedos(&model)) < 1e-5);
        let [before, after] = [&model, &merged].map(materials);
        assert!((after[0].share - before[0].share - before[1].share).abs() < 1e-5, "{after:?}");
        assert!(after[1].share == 0.0 && (after[2].share - before[2].share).abs() < 1e-6, "{after:?}");
        let dark = edited(&model, &of("0*=0.5,1.into=0")).expect("both exist");
        let [whole, half] = [&merged, &dark].map(albedos);
        assert!((half[2][0] / whole[2][0] - 0.5).abs() < 0.03, "a mixed one: {half:?} {whole:?}");
        let of_one = albedos(&edited(&model, &of("0*=0.5")).expect("it exists"));
        assert!(of_one[2][0] / whole[2][0] > 0.7, "the control: {of_one:?}");
    }

    #[test]
    fn a_split_makes_a_material_of_a_place() {
        let model = model();
        // Means 6 and 7 have the places 11 and 13.
        let split = edited(&model, &of("2.split=13:0:0:2.5,3=#ffffff")).expect("it exists");
        let (before, after) = (albedos(&model), albedos(&split));
        assert!(apart(&before[..6], &after[..6]) < 1e-5, "{after:?}");
        assert!(after[6][0] > 0.9 && after[7][2] > 0.9, "{after:?}");
        assert_eq!((split.prototypes.len(), split.gaussians.prototypes()), (4, 4));
        let mask = albedos(&mask(edited(&model, &of("2.split=13:0:0:2.5")).unwrap(), 3).unwrap());
        assert!(mask[5][0] < 1e-3 && mask[6][0] > 0.99, "{mask:?}");
        let nothing = edited(&model, &of("2.split=99:0:0:1")).expect("it exists");
        assert_eq!(materials(&nothing)[3].share, 0.0);
    }

    #[test]
    fn merges_and_splits_without_their_materials_are_refused() {
        let fault = |text: &str| first_fault(3, &of(text)).map(|(i, field, _)| (i, field));
        assert_eq!(fault("0*=2,3.into=0"), Some((1, "material")));
        assert_eq!(fault("0*=2,0.into=3"), Some((1, "into")));
        assert_eq!(fault("3*=2,0.split=0:0:0:1"), None, "a split counts before other changes");
        assert_eq!(fault("4*=2,0.split=0:0:0:1"), Some((0, "material")));
        assert_eq!(
            first_fault(MAX_MATERIALS, &of("0.split=0:0:0:1")).map(|(_, field, _)| field),
            Some("split")
        );
        assert!(edited(&model(), &of("7.into=0")).is_err());
    }
}
