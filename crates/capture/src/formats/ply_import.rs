//! Imports models from PLY: Relume's own files, whose columns are recognised with or without their comments, and
//! ordinary splat files, which have colour but no materials.

use glam::{DVec3, Quat, Vec3};
use serde_json::json;

pub use crate::formats::ply_table::PlyError;

use crate::formats::ply_model::{METADATA_COMMENT, PlyMetadata};
use crate::formats::ply_table::{PlyTable, bad};
use crate::formats::splats::{MAX_SPLAT_SH_DEGREE, outward_axis};
use relume_scene::{
    Field, Gaussians, IndirectForm, Model, NormalForm, VisibilityForm, sh_count, softplus_inverse,
};

/// Highest supported SH degree of a visibility field.
const MAX_VISIBILITY_DEGREE: usize = 8;
/// Size of the environment of an imported model, which is uniform and white.
const LIGHT_SIZE: (usize, usize) = (16, 8);
/// Share of the Gaussians that the unit ball of the world contains, for files that do not state the scale of the
/// world.
const HELD: f64 = 0.98;
/// Least distance of a probability from 0 and 1 before its logit is taken.
const MIN_PROBABILITY: f32 = 1e-7;

/// Reads a model. PLY files contain no light: the environment of the model is white and uniform. A file without
/// material columns gives a model with colour only ([`Model::has_materials`] is false).
///
/// # Errors
/// Names the property or vertex that is missing or wrong.
pub fn decode(bytes: &[u8]) -> Result<Model, PlyError> {
    let table = PlyTable::read(bytes, usize::MAX)?;
    let columns = SplatColumns::of(&table)?;
    let mut gaussians = Gaussians::zeroed(
        table.rows().len(),
        1,
        columns.material.as_ref().map_or(0, |m| m.visibility_degree),
        columns.degree,
    );
    for (i, row) in table.rows().enumerate() {
        if row.iter().any(|v| !v.is_finite()) {
            return bad(format!("vertex {i}"), "has a value that is not finite");
        }
        columns.read_splat(row, i, &mut gaussians);
        if let Some(material) = &columns.material {
            material.read(row, i, &mut gaussians);
        }
    }
    let lit = columns.material.is_some();
    let mut model = Model {
        card: json!({ "imported": { "from": "ply", "materials": lit } }),
        ..Model::new(
            gaussians,
            vec![[0.0; 3]],
            vec![[softplus_inverse(1.0); 3]; LIGHT_SIZE.0 * LIGHT_SIZE.1],
            (LIGHT_SIZE.0, LIGHT_SIZE.1),
        )
    };
    read_metadata(&table, &mut model)?;
    if columns.material.as_ref().is_none_or(|m| m.visibility.is_empty()) {
        (model.shading.visibility, model.shading.indirect) = (VisibilityForm::Off, IndirectForm::Off);
    }
    if model.shading.indirect == IndirectForm::Learned {
        model.shading.indirect = IndirectForm::Off;
    }
    into_world(&mut model);
    if let Some(normal) = columns.normal {
        table.rows().enumerate().for_each(|(i, row)| set_normal(&mut model, i, pick(row, normal)));
    }
    model.check().map_err(|e| PlyError { field: e.field.to_owned(), reason: e.reason })?;
    Ok(model)
}

/// Reads shading options and world transform from the comments. Without them, the transform follows from the
/// Gaussians.
fn read_metadata(table: &PlyTable, model: &mut Model) -> Result<(), PlyError> {
    if table.comments.iter().any(|line| line.ends_with("SplatRenderMode: default")) {
        model.shading.low_pass_compensation = false;
    }
    match table.comments.iter().find_map(|line| line.strip_prefix(METADATA_COMMENT)) {
        Some(text) => {
            let metadata: PlyMetadata = match serde_json::from_str(text) {
                Ok(metadata) => metadata,
                Err(error) => return bad("comment relume", error.to_string()),
            };
            if !(metadata.world_scale.is_finite() && metadata.world_scale > 0.0) {
                return bad("comment relume", "world_scale must be above 0");
            }
            (model.world_scale, model.world_offset) = (metadata.world_scale, metadata.world_offset);
            (model.shading, model.framing) = (metadata.shading, metadata.framing);
        }
        None => (model.world_scale, model.world_offset) = around(&model.gaussians),
    }
    Ok(())
}

/// Scale and offset of a world around the Gaussians, centred on the median of their centres.
fn around(gaussians: &Gaussians) -> (f64, DVec3) {
    let centres = || gaussians.field(Field::Mean).as_chunks::<3>().0.iter();
    let at_share = |mut values: Vec<f64>, share: f64| {
        values.sort_by(f64::total_cmp);
        values.get(((values.len() as f64 * share) as usize).min(values.len().saturating_sub(1))).copied()
    };
    let median = |axis: usize| at_share(centres().map(|c| f64::from(c[axis])).collect(), 0.5).unwrap_or(0.0);
    let centre = DVec3::new(median(0), median(1), median(2));
    let distance = |c: &[f32; 3]| (DVec3::from(c.map(f64::from)) - centre).length();
    let radius = at_share(centres().map(distance).collect(), HELD).filter(|r| *r > 0.0);
    (1.0 / radius.unwrap_or(1.0), -centre)
}

/// Converts the Gaussians from capture units to the world of `model`.
fn into_world(model: &mut Model) {
    let (scale, offset) = (model.world_scale, model.world_offset);
    for centre in model.gaussians.field_mut(Field::Mean).as_chunks_mut::<3>().0 {
        *centre = ((DVec3::from(centre.map(f64::from)) + offset) * scale).as_vec3().to_array();
    }
    let grow = scale.ln() as f32;
    model.gaussians.field_mut(Field::LogScale).iter_mut().for_each(|s| *s += grow);
}

/// Sets the normal field so that the shading normal, seen from outside, is `unit`.
fn set_normal(model: &mut Model, i: usize, unit: [f32; 3]) {
    let unit = Vec3::from(unit).normalize_or_zero();
    let own = match model.shading.normal {
        NormalForm::Free => unit,
        NormalForm::ShortestAxis if unit == Vec3::ZERO => Vec3::ZERO,
        NormalForm::ShortestAxis => unit - outward_axis(model, i),
    };
    model.gaussians.row_mut(Field::Normal, i).copy_from_slice(&own.to_array());
}

fn pick<const N: usize>(row: &[f64], columns: [usize; N]) -> [f32; N] {
    columns.map(|c| row[c] as f32)
}

/// `logit(share)` for a share in [0, 1].
fn logit(share: f64) -> f32 {
    let share = (share as f32).clamp(MIN_PROBABILITY, 1.0 - MIN_PROBABILITY);
    (share / (1.0 - share)).ln()
}

/// Columns of the values of a splat.
struct SplatColumns {
    position: [usize; 3],
    scale: [usize; 3],
    rotation: [usize; 4],
    opacity: usize,
    degree: usize,
    /// `(degree + 1)^2` RGB triples, one per coefficient.
    harmonics: Vec<[usize; 3]>,
    normal: Option<[usize; 3]>,
    material: Option<MaterialColumns>,
}

struct MaterialColumns {
    albedo: [usize; 3],
    metallic: usize,
    roughness: usize,
    visibility: Vec<usize>,
    visibility_degree: usize,
    sheen: Option<usize>,
}

impl SplatColumns {
    fn of(table: &PlyTable) -> Result<Self, PlyError> {
        let rest = numbered(table, "f_rest");
        let bases = rest.len() / 3 + 1;
        let degree =
            (0..=MAX_SPLAT_SH_DEGREE).find(|l| sh_count(*l) == bases && rest.len().is_multiple_of(3));
        let Some(degree) = degree else {
            return bad(
                "property f_rest_*",
                format!("{} coefficients match no SH degree from 0 to 3", rest.len()),
            );
        };
        let first = named(table, ["f_dc_0", "f_dc_1", "f_dc_2"])?;
        let later = (1..bases).map(|j| std::array::from_fn(|c| rest[c * (bases - 1) + j - 1]));
        Ok(Self {
            position: named(table, ["x", "y", "z"])?,
            scale: named(table, ["scale_0", "scale_1", "scale_2"])?,
            rotation: named(table, ["rot_0", "rot_1", "rot_2", "rot_3"])?,
            opacity: named(table, ["opacity"])?[0],
            degree,
            harmonics: std::iter::once(first).chain(later).collect(),
            normal: named(table, ["nx", "ny", "nz"]).ok(),
            material: MaterialColumns::of(table)?,
        })
    }

    fn read_splat(&self, row: &[f64], i: usize, out: &mut Gaussians) {
        out.row_mut(Field::Mean, i).copy_from_slice(&pick(row, self.position));
        out.row_mut(Field::LogScale, i).copy_from_slice(&pick(row, self.scale));
        let [w, x, y, z] = pick(row, self.rotation);
        let q = Quat::from_xyzw(x, y, z, w);
        let q = if q.length() > 1e-12 { q } else { Quat::IDENTITY };
        out.row_mut(Field::Quaternion, i).copy_from_slice(&[q.w, q.x, q.y, q.z]);
        out.row_mut(Field::OpacityLogit, i)[0] = row[self.opacity] as f32;
        let harmonics = self.harmonics.iter().flat_map(|columns| pick(row, *columns));
        out.row_mut(Field::Radiance, i).iter_mut().zip(harmonics).for_each(|(o, v)| *o = v);
    }
}

impl MaterialColumns {
    /// `None` for a file without albedo.
    fn of(table: &PlyTable) -> Result<Option<Self>, PlyError> {
        let Ok(albedo) = named(table, ["albedo_0", "albedo_1", "albedo_2"]) else { return Ok(None) };
        let [metallic, roughness] = named(table, ["metallic", "roughness"])?;
        let visibility = numbered(table, "visibility");
        let sh_degree = (0..=MAX_VISIBILITY_DEGREE).find(|l| sh_count(*l) == visibility.len().max(1));
        let Some(visibility_degree) = sh_degree else {
            return bad(
                "property visibility_*",
                format!("{} coefficients match no SH degree", visibility.len()),
            );
        };
        let sheen = table.column("sheen");
        Ok(Some(Self { albedo, metallic, roughness, visibility, visibility_degree, sheen }))
    }

    fn read(&self, row: &[f64], i: usize, out: &mut Gaussians) {
        // The only prototype is black, so the residual is the albedo.
        out.row_mut(Field::Residual, i).copy_from_slice(&pick(row, self.albedo));
        out.row_mut(Field::MetalLogit, i)[0] = logit(row[self.metallic]);
        out.row_mut(Field::RoughLogit, i)[0] = logit(row[self.roughness]);
        let visibility = self.visibility.iter().map(|c| row[*c] as f32);
        out.row_mut(Field::Visibility, i).iter_mut().zip(visibility).for_each(|(o, v)| *o = v);
        out.row_mut(Field::Sheen, i)[0] = self.sheen.map_or(0.0, |c| row[c] as f32);
    }
}

fn named<const N: usize>(table: &PlyTable, names: [&str; N]) -> Result<[usize; N], PlyError> {
    let mut out = [0; N];
    for (o, name) in out.iter_mut().zip(names) {
        match table.column(name) {
            Some(column) => *o = column,
            None => return bad(format!("property {name}"), "is missing: this is not a splat file"),
        }
    }
    Ok(out)
}

/// Columns `stem_0`, `stem_1`, ... up to the first that is missing.
fn numbered(table: &PlyTable, stem: &str) -> Vec<usize> {
    (0..).map_while(|k| table.column(&format!("{stem}_{k}"))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::ply_model::{self, PlyProperties};
    use crate::formats::splats::{Layer, Splats, tests::example};
    use relume_compare::worst;

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
            let one = |m: &crate::formats::splats::SplatMaterial| {
                [&m.albedo[..], &[m.metallic, m.roughness]].concat()
            };
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
        model
    }

    #[test]
    fn own_files_are_read_back_with_or_without_comments() {
        let model = original();
        let bytes = ply_model::encode(&model);
        let back = decode(&bytes).unwrap();
        assert!(same(&model, &back) && back.has_materials());
        assert_eq!((back.world_scale, back.world_offset), (model.world_scale, model.world_offset));
        assert_eq!(back.shading, model.shading);
        let g = &back.gaussians;
        assert_eq!(
            (g.row(Field::Sheen, 1), g.row(Field::Visibility, 1)),
            (&[0.25][..], &[3.0, 0.0, -1.0, 0.0][..])
        );
        assert_eq!(g.row(Field::Radiance, 1)[..12], *model.gaussians.row(Field::Radiance, 1));
        let bare = decode(&without_comments(&bytes)).unwrap();
        assert!(same(&model, &bare) && bare.has_materials());
        assert_eq!(bare.shading.occluder_reach, None, "the control: only a comment states it");
        let mut other = model.clone();
        other.gaussians.row_mut(Field::RoughLogit, 0)[0] = 0.1;
        assert!(!same(&other, &back), "the control");
    }

    #[test]
    fn ordinary_files_give_colour_without_materials() {
        let model = original();
        let plain = Splats::of(&model).painted(Layer::Albedo);
        let back = decode(&ply_model::encode_splats(&model, &plain, PlyProperties::Ordinary)).unwrap();
        assert!(!back.has_materials());
        assert_eq!(back.shading.visibility, VisibilityForm::Off);
        assert!(near(&back.gaussians.row(Field::Radiance, 1)[..3], &plain.harmonics[1]));
        assert_eq!(back.gaussians.radiance_degree(), 3, "the degree that viewers expect");
    }

    #[test]
    fn files_without_world_scale_are_scaled_to_the_unit_ball() {
        let bare = decode(&without_comments(&ply_model::encode(&original()))).unwrap();
        let far =
            bare.gaussians.field(Field::Mean).as_chunks::<3>().0.iter().map(|c| Vec3::from(*c).length());
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
        assert!(decode(&poisoned).map(|_| ()).unwrap_err().to_string().contains("vertex 1"));
        assert!(decode(b"ply\n").is_err() && decode(&bytes[..bytes.len() - 1]).is_err());
    }
}
