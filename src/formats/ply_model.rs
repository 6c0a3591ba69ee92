//! Models as PLY: the properties that splat viewers read, followed by the materials for relighting.
//!
//! The first properties are those of the 3D Gaussian Splatting authors' own files: position, normal, radiance SH
//! (`f_dc_*`, then `f_rest_*` channel by channel), opacity logit, log-scales, quaternion `w x y z`. After them,
//! marked by `comment relight_schema 1`: `albedo_0..2` (linear Rec.709), `metallic`, `roughness`, all
//! activated, and `visibility_*` (SH coefficients, `l * l + l + m`). Sheen is left out, since the
//! materials of other tools define it differently. All values are in capture coordinates.
//! `comment SplatRenderMode: mip` or `default`, a convention of Brush and gsplat, tells a viewer whether the opacities
//! need low-pass compensation.

use glam::{DQuat, DVec3, Vec3};

use crate::scene::{Field, Model, NormalForm, sh_count};

/// SH degree of `f_rest_*` that viewers expect; coefficients that a model lacks are written as 0.
const VIEWER_DEGREE: usize = 3;

/// The bytes of a binary little-endian PLY file.
pub fn encode(model: &Model) -> Vec<u8> {
    let g = &model.gaussians;
    let names = property_names(sh_count(g.visibility_order()));
    let mut out = header(g.len(), &names, model.shading.low_pass_compensation).into_bytes();
    out.reserve(g.len() * names.len() * 4);
    let mut row = Vec::with_capacity(names.len());
    for i in 0..g.len() {
        row.clear();
        splat(model, i, &mut row);
        material(model, i, &mut row);
        debug_assert_eq!(row.len(), names.len());
        row.iter().for_each(|v| out.extend(v.to_le_bytes()));
    }
    out
}

fn header(count: usize, names: &[String], compensated: bool) -> String {
    let mut text = String::from("ply\nformat binary_little_endian 1.0\n");
    text += "comment relight_schema 1\n";
    text += "comment albedo is linear Rec.709; visibility is real SH, index l*l+l+m\n";
    text += &format!("comment SplatRenderMode: {}\n", if compensated { "mip" } else { "default" });
    text += &format!("element vertex {count}\n");
    names.iter().for_each(|name| text += &format!("property float {name}\n"));
    text + "end_header\n"
}

fn property_names(visibility: usize) -> Vec<String> {
    let numbered = |stem: &str, n: usize| (0..n).map(|i| format!("{stem}_{i}")).collect::<Vec<_>>();
    let plain = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
    [
        plain(&["x", "y", "z", "nx", "ny", "nz"]),
        numbered("f_dc", 3),
        numbered("f_rest", 3 * (sh_count(VIEWER_DEGREE) - 1)),
        plain(&["opacity"]),
        numbered("scale", 3),
        numbered("rot", 4),
        numbered("albedo", 3),
        plain(&["metallic", "roughness"]),
        numbered("visibility", visibility),
    ]
    .concat()
}

/// The properties every viewer reads.
fn splat(model: &Model, i: usize, row: &mut Vec<f32>) {
    let g = &model.gaussians;
    let mean = DVec3::from(g.get::<3>(Field::Mean, i).map(f64::from));
    let position = mean / model.world_scale - model.world_offset;
    row.extend(position.as_vec3().to_array());
    row.extend(normal(model, i).to_array());
    let radiance = g.row(Field::Radiance, i);
    row.extend(&radiance[..3]);
    for channel in 0..3 {
        let rest = radiance[3..].iter().skip(channel).step_by(3).copied().chain(std::iter::repeat(0.0));
        row.extend(rest.take(sh_count(VIEWER_DEGREE) - 1));
    }
    row.push(g.row(Field::OpacityLogit, i)[0]);
    let shrink = model.world_scale.ln() as f32;
    row.extend(g.row(Field::LogScale, i).iter().map(|s| s - shrink));
    let q = orientation(model, i);
    row.extend([q.w, q.x, q.y, q.z].map(|v| v as f32));
}

/// The relighting extension.
fn material(model: &Model, i: usize, row: &mut Vec<f32>) {
    let g = &model.gaussians;
    let sigmoid = |x: f32| 1.0 / (1.0 + (-x).exp());
    row.extend(albedo(model, i));
    row.push(sigmoid(g.row(Field::MetalLogit, i)[0]));
    row.push(sigmoid(g.row(Field::RoughLogit, i)[0]));
    row.extend(g.row(Field::Visibility, i));
}

/// The mixture of prototypes plus the residual, in [0, 1].
fn albedo(model: &Model, i: usize) -> [f32; 3] {
    let logits = model.gaussians.row(Field::ProtoLogits, i);
    let largest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let weights: Vec<f32> = logits.iter().map(|l| (l - largest).exp()).collect();
    let total: f32 = weights.iter().sum::<f32>().max(f32::MIN_POSITIVE);
    let residual = model.gaussians.row(Field::Residual, i);
    std::array::from_fn(|c| {
        let mixed = weights.iter().zip(&model.prototypes).map(|(w, p)| w * p[c].clamp(0.0, 1.0));
        (mixed.sum::<f32>() / total + residual[c]).clamp(0.0, 1.0)
    })
}

/// Unit orientation; the identity for a quaternion of length 0.
fn orientation(model: &Model, i: usize) -> DQuat {
    let [w, x, y, z] = model.gaussians.get::<4>(Field::Quaternion, i).map(f64::from);
    let q = DQuat::from_xyzw(x, y, z, w);
    if q.length() > 1e-12 { q.normalize() } else { DQuat::IDENTITY }
}

/// The shading normal. A renderer turns the shortest axis to its camera. A file has no camera, so the axis is turned
/// to the side where visibility is larger, which the degree-1 part of the visibility field gives.
fn normal(model: &Model, i: usize) -> Vec3 {
    let g = &model.gaussians;
    let own = Vec3::from(g.get::<3>(Field::Normal, i));
    let sum = match model.shading.normal {
        NormalForm::Free => own,
        NormalForm::ShortestAxis => {
            let axis = shortest_axis(model, i);
            let c = g.row(Field::Visibility, i);
            let open = if c.len() >= 4 { Vec3::new(-c[3], -c[1], c[2]) } else { Vec3::ZERO };
            if open.dot(axis) < 0.0 { own - axis } else { own + axis }
        }
    };
    sum.normalize_or_zero()
}

fn shortest_axis(model: &Model, i: usize) -> Vec3 {
    let s = model.gaussians.get::<3>(Field::LogScale, i);
    let shortest = if s[0] <= s[1] && s[0] <= s[2] {
        DVec3::X
    } else if s[1] <= s[2] {
        DVec3::Y
    } else {
        DVec3::Z
    };
    (orientation(model, i) * shortest).as_vec3()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Gaussians, ShadingOptions};

    fn example() -> Model {
        let mut g = Gaussians::zeroed(2, 2, 1, 1);
        g.row_mut(Field::Mean, 1).copy_from_slice(&[1.0, -0.5, 0.25]);
        g.row_mut(Field::LogScale, 1).copy_from_slice(&[-1.0, -2.0, -3.0]);
        g.row_mut(Field::Quaternion, 1).copy_from_slice(&[2.0, 0.0, 0.0, 0.0]);
        g.row_mut(Field::OpacityLogit, 1)[0] = 1.5;
        g.row_mut(Field::ProtoLogits, 1).copy_from_slice(&[0.0, 3f32.ln()]);
        g.row_mut(Field::Residual, 1).copy_from_slice(&[0.1, 0.0, -1.0]);
        g.row_mut(Field::RoughLogit, 1)[0] = 3f32.ln();
        g.row_mut(Field::Visibility, 1).copy_from_slice(&[3.0, 0.0, -1.0, 0.0]);
        let radiance: Vec<f32> = (0..12).map(|k| k as f32).collect();
        g.row_mut(Field::Radiance, 1).copy_from_slice(&radiance);
        Model {
            gaussians: g,
            prototypes: vec![[0.2, 0.4, 0.6], [0.6, 0.4, 0.2]],
            env_raw: vec![[0.0; 3]; 2],
            env_width: 2,
            env_height: 1,
            lights: Default::default(),
            shading: ShadingOptions::default(),
            world_scale: 2.0,
            world_offset: DVec3::new(0.0, 1.0, 0.0),
            framing: None,
            card: serde_json::Value::Null,
        }
    }

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
    fn the_first_columns_are_those_of_the_3dgs_authors() {
        let names = property_names(4);
        assert_eq!(names[..9], ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]);
        assert_eq!(
            (names[9].as_str(), names[53].as_str(), names[54].as_str()),
            ("f_rest_0", "f_rest_44", "opacity")
        );
        assert_eq!(names[55..62], ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]);
        assert_eq!(names[62..67], ["albedo_0", "albedo_1", "albedo_2", "metallic", "roughness"]);
        assert_eq!(names.len(), 67 + 4);
    }

    #[test]
    fn geometry_is_in_capture_units() {
        let bytes = encode(&example());
        let get = |name| property(&bytes, name);
        assert_eq!([get("x"), get("y"), get("z")], [0.5, -1.25, 0.125]);
        assert!((get("scale_1") - (-2.0 - 2f32.ln())).abs() < 1e-6);
        assert_eq!([get("rot_0"), get("rot_1"), get("opacity")], [1.0, 0.0, 1.5]);
        assert_eq!([get("nx"), get("ny"), get("nz")], [0.0, 0.0, -1.0], "the field is open downwards");
    }

    #[test]
    fn radiance_goes_channel_by_channel_and_materials_are_activated() {
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
    fn viewers_are_told_whether_opacities_expect_compensation() {
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
    fn our_own_point_reader_reads_it() {
        let points = crate::formats::ply_points::read_points(&encode(&example()), 2).unwrap();
        assert_eq!(points[1].0, DVec3::new(0.5, -1.25, 0.125));
    }
}
