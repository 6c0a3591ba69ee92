//! Models as PLY: the properties that splat viewers read, followed by the materials for relighting.
//!
//! The first properties are those of the original 3D Gaussian Splatting files: position, normal, radiance SH
//! (`f_dc_*`, then `f_rest_*` channel by channel), opacity logit, log-scales, quaternion `w x y z`. After them,
//! announced by `comment relight_schema 1`, follow `albedo_0..2` (linear Rec.709), `metallic`, `roughness`, all
//! activated, `visibility_*` (SH coefficients, index `l * l + l + m`) and, if the model has any, `sheen` (logarithm
//! of the diffuse term's gain at grazing view; specific to Relume, other tools define sheen differently) and
//! `sampling_rate` (pixels per unit of length in the photograph that shows the Gaussian largest). All values are in capture
//! coordinates. `comment SplatRenderMode: mip` or `default`, a convention of Brush and gsplat, tells a
//! viewer whether the opacities need low-pass compensation. `comment relume {...}` states in JSON how the Gaussians
//! are shaded (`PlyMetadata`).

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::formats::splats::{MAX_SPLAT_SH_DEGREE, Splats};
use relume_scene::{Field, Framing, Model, ShadingOptions, sh_count};

/// Start of the comment that contains [`PlyMetadata`].
pub(super) const METADATA_COMMENT: &str = "comment relume ";

/// Properties of a model other than its Gaussians and its light.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct PlyMetadata {
    /// Capture to model: `x_model = scale * (x_capture + offset)`.
    pub world_scale: f64,
    /// Offset of the transform in `world_scale`, capture units.
    pub world_offset: DVec3,
    /// The shading options of the forward model.
    pub shading: ShadingOptions,
    /// Default view for captures without masks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub framing: Option<Framing>,
}

/// The set of properties of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlyProperties {
    /// The properties that viewers read.
    Ordinary,
    /// The properties that viewers read, and the materials.
    Relightable,
}

/// The bytes of a binary little-endian PLY file with the materials.
pub fn encode(model: &Model) -> Vec<u8> {
    encode_splats(model, &Splats::of(model), PlyProperties::Relightable)
}

/// The bytes of a PLY file of `splats`, which were made from `model`, with the properties of `columns`.
pub fn encode_splats(model: &Model, splats: &Splats, columns: PlyProperties) -> Vec<u8> {
    let fields = match columns {
        PlyProperties::Ordinary => &[][..],
        PlyProperties::Relightable => &[Field::Visibility, Field::Sheen, Field::SamplingRate][..],
    };
    let is_written = |field: &Field| {
        *field == Field::Visibility || model.gaussians.field(*field).iter().any(|value| *value != 0.0)
    };
    let fields: Vec<Field> = fields.iter().copied().filter(is_written).collect();
    let names = property_names(model, columns, &fields);
    let mut out = header(model, splats.len(), &names, columns).into_bytes();
    out.reserve(splats.len() * names.len() * 4);
    let mut row = Vec::with_capacity(names.len());
    for i in 0..splats.len() {
        row.clear();
        splat(splats, i, &mut row);
        if columns == PlyProperties::Relightable {
            let material = &splats.materials[i];
            row.extend(material.albedo);
            row.extend([material.metallic, material.roughness]);
        }
        let units = |field: Field| if field == Field::SamplingRate { model.world_scale } else { 1.0 };
        for field in &fields {
            row.extend(model.gaussians.row(*field, i).iter().map(|v| (f64::from(*v) * units(*field)) as f32));
        }
        debug_assert_eq!(row.len(), names.len());
        row.iter().for_each(|v| out.extend(v.to_le_bytes()));
    }
    out
}

fn header(model: &Model, count: usize, names: &[String], columns: PlyProperties) -> String {
    let mut text = String::from("ply\nformat binary_little_endian 1.0\n");
    if columns == PlyProperties::Relightable {
        text += "comment relight_schema 1\n";
        text += "comment albedo is linear Rec.709; visibility is real SH, index l*l+l+m\n";
    }
    let mode = if model.shading.low_pass_compensation { "mip" } else { "default" };
    text += &format!("comment SplatRenderMode: {mode}\n");
    let metadata = PlyMetadata {
        world_scale: model.world_scale,
        world_offset: model.world_offset,
        shading: model.shading,
        framing: model.framing,
    };
    text += &format!("{METADATA_COMMENT}{}\n", serde_json::to_string(&metadata).unwrap_or_default());
    text += &format!("element vertex {count}\n");
    names.iter().for_each(|name| text += &format!("property float {name}\n"));
    text + "end_header\n"
}

/// Names of the properties of a file: those of `columns`, then those of `fields`.
fn property_names(model: &Model, columns: PlyProperties, fields: &[Field]) -> Vec<String> {
    let numbered = |stem: &str, n: usize| (0..n).map(|i| format!("{stem}_{i}")).collect::<Vec<_>>();
    let plain = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
    let mut out = [
        plain(&["x", "y", "z", "nx", "ny", "nz"]),
        numbered("f_dc", 3),
        numbered("f_rest", 3 * (sh_count(MAX_SPLAT_SH_DEGREE) - 1)),
        plain(&["opacity"]),
        numbered("scale", 3),
        numbered("rot", 4),
    ]
    .concat();
    if columns == PlyProperties::Relightable {
        out.extend(numbered("albedo", 3));
        out.extend(plain(&["metallic", "roughness"]));
    }
    for field in fields {
        match field {
            Field::Sheen => out.push("sheen".to_owned()),
            Field::SamplingRate => out.push("sampling_rate".to_owned()),
            _ => out.extend(numbered("visibility", model.gaussians.width(*field))),
        }
    }
    out
}

/// Appends the properties that every viewer reads. Coefficients that the colour lacks are 0.
fn splat(splats: &Splats, i: usize, row: &mut Vec<f32>) {
    row.extend(splats.positions[i].to_array());
    row.extend(splats.normals[i].to_array());
    let [first, rest @ ..] = splats.harmonics(i) else { return };
    row.extend(first);
    for channel in 0..3 {
        let rest = rest.iter().map(|c| c[channel]).chain(std::iter::repeat(0.0));
        row.extend(rest.take(sh_count(MAX_SPLAT_SH_DEGREE) - 1));
    }
    row.push(splats.opacity_logits[i]);
    row.extend(splats.log_scales[i]);
    let q = splats.rotations[i];
    row.extend([q.w, q.x, q.y, q.z].map(|v| v as f32));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::splats::tests::example;

    /// Property `name` of the second Gaussian.
    fn property(bytes: &[u8], name: &str) -> f32 {
        let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let text = std::str::from_utf8(&bytes[..end]).unwrap();
        let names: Vec<&str> = text.lines().filter_map(|l| l.strip_prefix("property float ")).collect();
        let column = names.iter().position(|n| *n == name).unwrap();
        let at = end + 4 * (names.len() + column);
        f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
    }

    #[test]
    fn first_columns_follow_the_original_3dgs_layout() {
        let names = property_names(&example(), PlyProperties::Relightable, &[Field::Visibility]);
        assert_eq!(names[..9], ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]);
        assert_eq!(
            (names[9].as_str(), names[53].as_str(), names[54].as_str()),
            ("f_rest_0", "f_rest_44", "opacity")
        );
        assert_eq!(names[55..62], ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]);
        assert_eq!(names[62..67], ["albedo_0", "albedo_1", "albedo_2", "metallic", "roughness"]);
        assert_eq!(names.len(), 67 + 4);
        assert_eq!(
            property_names(&example(), PlyProperties::Ordinary, &[]),
            names[..62],
            "an ordinary file ends there"
        );
        assert!(!encode(&example()).windows(6).any(|w| w == b"sheen\n"), "the model has no sheen");
        let mut cloth = example();
        cloth.gaussians.row_mut(Field::Sheen, 1)[0] = 0.5;
        assert_eq!(property(&encode(&cloth), "sheen"), 0.5);
        cloth.gaussians.row_mut(Field::SamplingRate, 1)[0] = 8.0;
        assert_eq!(property(&encode(&cloth), "sampling_rate"), 16.0, "pixels per unit of the capture");
    }

    #[test]
    fn geometry_is_in_capture_units() {
        let bytes = encode(&example());
        let get = |name| property(&bytes, name);
        assert_eq!([get("x"), get("y"), get("z")], [0.5, -1.25, 0.125]);
        assert!((get("scale_1") - (-2.0 - 2f32.ln())).abs() < 1e-6);
        assert_eq!([get("rot_0"), get("rot_1"), get("opacity")], [1.0, 0.0, 1.5]);
        assert_eq!([get("nx"), get("ny"), get("nz")], [0.0, 0.0, -1.0], "visibility is larger below");
    }

    #[test]
    fn radiance_is_stored_by_channel_and_materials_are_activated() {
        let bytes = encode(&example());
        let get = |name| property(&bytes, name);
        assert_eq!([get("f_dc_0"), get("f_dc_1"), get("f_dc_2")], [0.0, 1.0, 2.0]);
        assert_eq!(
            [get("f_rest_0"), get("f_rest_1"), get("f_rest_2"), get("f_rest_3")],
            [3.0, 6.0, 9.0, 0.0]
        );
        assert_eq!([get("f_rest_15"), get("f_rest_30")], [4.0, 5.0]);
        let albedo = [get("albedo_0"), get("albedo_1"), get("albedo_2")];
        for (a, b) in albedo.into_iter().zip([0.6, 0.4, 0.0]) {
            assert!((a - b).abs() < 1e-6, "{albedo:?}");
        }
        assert!((get("roughness") - 0.75).abs() < 1e-6 && get("metallic") == 0.5);
        assert_eq!(get("visibility_2"), -1.0);
    }

    #[test]
    fn header_states_whether_opacities_need_compensation() {
        let says = |low_pass_compensation: bool, line: &str| {
            let mut model = example();
            model.shading.low_pass_compensation = low_pass_compensation;
            encode(&model).windows(line.len()).any(|w| w == line.as_bytes())
        };
        let (mip, plain) = ("\ncomment SplatRenderMode: mip\n", "\ncomment SplatRenderMode: default\n");
        assert_eq!([says(true, mip), says(true, plain)], [true, false]);
        assert_eq!([says(false, mip), says(false, plain)], [false, true]);
    }

    #[test]
    fn point_reader_reads_a_model_file() {
        let points = crate::formats::ply_points::read_points(&encode(&example()), 2).unwrap();
        assert_eq!(points[1].0, DVec3::new(0.5, -1.25, 0.125));
    }
}
