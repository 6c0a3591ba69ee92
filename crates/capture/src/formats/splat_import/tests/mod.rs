mod hostile;
mod programs;

use glam::Vec3;

use super::*;
use crate::formats::ply_model::{self, PlyProperties};
use crate::formats::splats::{Layer, Splats, tests::example};
use relume_compare::worst;
use relume_scene::Field;

fn imported(bytes: &[u8]) -> Model {
    decode(bytes).unwrap().model
}

fn without_comments(bytes: &[u8]) -> Vec<u8> {
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap();
    let text = std::str::from_utf8(&bytes[..end]).unwrap();
    let kept = text.lines().filter(|l| !l.starts_with("comment")).map(|l| format!("{l}\n"));
    [kept.collect::<String>().as_bytes(), &bytes[end..]].concat()
}

fn near(a: &[f32], b: &[f32]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5)
}

/// Whether two models have the same Gaussians in capture units.
fn same(a: &Model, b: &Model) -> bool {
    let (a, b) = (Splats::of(a), Splats::of(b));
    let vectors = |v: &[Vec3]| v.iter().flat_map(|v| v.to_array()).collect::<Vec<_>>();
    let materials = |s: &Splats| {
        let one =
            |m: &crate::formats::splats::SplatMaterial| [&m.albedo[..], &[m.metallic, m.roughness]].concat();
        s.materials.iter().flat_map(one).collect::<Vec<_>>()
    };
    near(&vectors(&a.positions), &vectors(&b.positions))
        && near(&vectors(&a.normals), &vectors(&b.normals))
        && near(a.log_scales.as_flattened(), b.log_scales.as_flattened())
        && near(&a.opacity_logits, &b.opacity_logits)
        && near(&materials(&a), &materials(&b))
}

fn original() -> Model {
    let mut model = example();
    model.shading.occluder_reach = Some(0.5);
    model.gaussians.row_mut(Field::Normal, 1).copy_from_slice(&[0.3, 0.1, 0.0]);
    model.gaussians.row_mut(Field::Sheen, 1)[0] = 0.25;
    model.gaussians.field_mut(Field::SamplingRate).copy_from_slice(&[-25.0, 75.0]);
    model
}

#[test]
fn own_files_are_read_back_with_or_without_comments() {
    let model = original();
    let bytes = ply_model::encode(&model);
    let back = imported(&bytes);
    assert!(same(&model, &back) && back.has_materials());
    assert_eq!((back.world_scale, back.world_offset), (model.world_scale, model.world_offset));
    assert_eq!(back.shading, model.shading);
    let g = &back.gaussians;
    assert_eq!(
        (g.row(Field::Sheen, 1), g.row(Field::Visibility, 1)),
        (&[0.25][..], &[3.0, 0.0, -1.0, 0.0][..])
    );
    assert_eq!(g.field(Field::SamplingRate), [-25.0, 75.0]);
    assert_eq!(g.row(Field::Radiance, 1)[..12], *model.gaussians.row(Field::Radiance, 1));
    let bare = imported(&without_comments(&bytes));
    assert!(same(&model, &bare) && bare.has_materials());
    assert_eq!(bare.shading.occluder_reach, None, "the control: only a comment states it");
    assert!(bare.shading.conserves_energy && !model.shading.conserves_energy);
    let mut other = model.clone();
    other.gaussians.row_mut(Field::RoughLogit, 0)[0] = 0.1;
    assert!(!same(&other, &back), "the control");
}

#[test]
fn ordinary_files_give_colour_without_materials() {
    let model = original();
    let plain = Splats::of(&model).painted(Layer::Albedo);
    let back = imported(&ply_model::encode_splats(&model, &plain, PlyProperties::Ordinary));
    assert!(!back.has_materials());
    assert_eq!(back.shading.visibility, VisibilityForm::Off);
    assert!(near(&back.gaussians.row(Field::Radiance, 1)[..3], &plain.harmonics[1]));
    assert_eq!(back.gaussians.radiance_degree(), 3, "the degree that viewers expect");
}

#[test]
fn files_without_world_scale_are_scaled_to_the_unit_ball() {
    let bare = imported(&without_comments(&ply_model::encode(&original())));
    let far = bare.gaussians.field(Field::Mean).as_chunks::<3>().0.iter().map(|c| Vec3::from(*c).length());
    assert!((worst(far) - 1.0).abs() < 1e-5);
}

#[test]
fn missing_properties_and_invalid_values_are_named() {
    let bytes = ply_model::encode(&original());
    let error = |from: &str, to: &str| {
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
        let changed = [&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat();
        decode(&changed).map(|_| ()).unwrap_err().to_string()
    };
    assert!(error("float rot_3", "float rot_x").contains("rot_3"));
    assert!(error("float roughness", "float roughnesx").contains("roughness"));
    assert!(error("float f_rest_8\n", "float f_rest_x\n").contains("f_rest"));
    assert!(error("float visibility_3", "float visibility_x").contains("visibility"));
    assert!(error("\"world_scale\":2.0", "\"world_scale\":0.0").contains("world_scale"));
    assert!(error("comment relume {", "comment relume [").contains("comment relume"));
    let mut poisoned = bytes.clone();
    let last = poisoned.len() - 4;
    poisoned[last..].copy_from_slice(&f32::NAN.to_le_bytes());
    let notes = decode(&poisoned).unwrap().notes;
    assert!(notes[0].contains("1 of 2 splats") && notes[0].contains("vertex 1"), "{notes:?}");
    assert!(decode(b"ply\n").is_err() && decode(&bytes[..bytes.len() - 1]).is_err());
}

#[test]
fn files_of_relume_keep_their_kind_of_opacity() {
    for compensation in [false, true] {
        let mut model = original();
        model.shading.low_pass_compensation = compensation;
        for properties in [PlyProperties::Ordinary, PlyProperties::Relightable] {
            let bytes = ply_model::encode_splats(&model, &Splats::of(&model), properties);
            let back = imported(&bytes);
            assert_eq!(back.shading.low_pass_compensation, compensation, "{properties:?}");
            let again = ply_model::encode_splats(&back, &Splats::of(&back), properties);
            assert_eq!(imported(&again).shading.low_pass_compensation, compensation, "written again");
        }
    }
    let bare = imported(&without_comments(&ply_model::encode(&original())));
    assert!(bare.shading.low_pass_compensation, "materials without comments come from Relume");
}
