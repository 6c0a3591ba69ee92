//! Splats as OpenUSD with the schema `ParticleField3DGaussianSplat` (OpenUSD 26.03). Materials are stored as primvars
//! named after the inputs of `UsdPreviewSurface`. The output is text, or a package that contains the text.

use std::fmt::Write;
use std::io::{Cursor, Write as _};

use glam::Vec3;
use zip::result::ZipResult;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use crate::formats::splats::Splats;
use relume_scene::sh_count;

/// Radius of a Gaussian's extent, standard deviations.
const REACH: f32 = 3.0;
/// Alignment that a package requires of each file in it, bytes.
const ALIGNMENT: u16 = 64;

/// The text of a `.usda` file of `splats`, which have +Y up.
pub fn encode_splats(splats: &Splats) -> String {
    let mut out = String::from(HEAD);
    let every = 0..splats.len();
    let field = |out: &mut String, declaration: &str, rows: &mut dyn Iterator<Item = String>, note: &str| {
        let _ = write!(out, "    {declaration} = [");
        rows.enumerate().for_each(|(i, row)| {
            out.push_str(if i == 0 { "" } else { ", " });
            out.push_str(&row);
        });
        out.push(']');
        out.push_str(note);
        out.push('\n');
    };
    let vector = |v: Vec3| tuple(&v.to_array());
    let extent = extent(splats);
    field(&mut out, "float3[] extent", &mut extent.into_iter().map(vector), "");
    field(&mut out, "point3f[] positions", &mut splats.positions.iter().map(|p| vector(*p)), "");
    let rotations = &mut splats.rotations.iter().map(|q| {
        let q = q.as_quat().normalize();
        tuple(&[q.w, q.x, q.y, q.z])
    });
    field(&mut out, "quatf[] orientations", rotations, "");
    field(&mut out, "float3[] scales", &mut every.clone().map(|i| tuple(&splats.scale(i))), "");
    field(&mut out, "float[] opacities", &mut every.clone().map(|i| splats.opacity(i).to_string()), "");
    let _ = writeln!(out, "    uniform int radiance:sphericalHarmonicsDegree = {}", splats.degree);
    let elements = format!(
        " (\n        elementSize = {}\n        interpolation = \"vertex\"\n    )",
        sh_count(splats.degree)
    );
    let harmonics = &mut splats.harmonics.iter().map(|c| tuple(c));
    field(&mut out, "float3[] radiance:sphericalHarmonicsCoefficients", harmonics, &elements);
    out.push_str("    uniform token projectionModeHint = \"perspective\"\n");
    out.push_str("    uniform token sortingModeHint = \"cameraDistance\"\n");
    let vertex = " (\n        interpolation = \"vertex\"\n    )";
    let shown = &mut every.map(|i| tuple(&splats.mean_colour(i)));
    field(&mut out, "color3f[] primvars:displayColor", shown, vertex);
    let materials = &splats.materials;
    let albedo = &mut materials.iter().map(|m| tuple(&m.albedo));
    field(&mut out, "color3f[] primvars:diffuseColor", albedo, vertex);
    let roughness = &mut materials.iter().map(|m| m.roughness.to_string());
    field(&mut out, "float[] primvars:roughness", roughness, vertex);
    let metallic = &mut materials.iter().map(|m| m.metallic.to_string());
    field(&mut out, "float[] primvars:metallic", metallic, vertex);
    field(&mut out, "normal3f[] primvars:normals", &mut splats.normals.iter().map(|n| vector(*n)), vertex);
    out + "}\n"
}

/// The bytes of a `.usdz` package of `splats`, which have +Y up.
///
/// # Errors
/// If the text is larger than the 4 GiB of a package.
pub fn encode_splats_package(splats: &Splats) -> ZipResult<Vec<u8>> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(zip::DateTime::DEFAULT)
        .with_alignment(ALIGNMENT);
    archive.start_file("model.usda", stored)?;
    archive.write_all(encode_splats(splats).as_bytes())?;
    Ok(archive.finish()?.into_inner())
}

const HEAD: &str = r#"#usda 1.0
(
    customLayerData = {
        string creator = "Relume"
        string radianceColorSpace = "srgb_rec709_display"
    }
    defaultPrim = "model"
    metersPerUnit = 1
    upAxis = "Y"
)

def ParticleField3DGaussianSplat "model"
{
"#;

fn tuple(values: &[f32]) -> String {
    let mut out = String::from("(");
    for (i, v) in values.iter().enumerate() {
        let _ = write!(out, "{}{v}", if i == 0 { "" } else { ", " });
    }
    out + ")"
}

/// Opposite corners of the box around all Gaussians.
fn extent(splats: &Splats) -> [Vec3; 2] {
    let ball = |i: usize| {
        let reach = splats.scale(i).into_iter().fold(0.0, f32::max) * REACH;
        [splats.positions[i] - reach, splats.positions[i] + reach]
    };
    let join = |[a, b]: [Vec3; 2], [c, d]: [Vec3; 2]| [a.min(c), b.max(d)];
    (0..splats.len()).map(ball).reduce(join).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::splats::tests::example;

    fn splats() -> Splats {
        Splats::of(&example()).with_y_up()
    }

    /// The values of a field, as text.
    fn values<'a>(text: &'a str, declaration: &str) -> Option<&'a str> {
        let at = text.find(&format!("    {declaration} = ["))?;
        let line = text[at..].lines().next()?;
        Some(&line[line.find('[')? + declaration.contains("[]") as usize..])
    }

    #[test]
    fn file_contains_the_values_of_the_model() {
        let text = encode_splats(&splats());
        let has = |declaration: &str, part: &str| {
            let found = values(&text, declaration).unwrap_or_else(|| panic!("{declaration} is missing"));
            assert!(found.contains(part), "{declaration}: {found}");
        };
        has("point3f[] positions", "(0.5, 0.125, 1.25)");
        has("float[] opacities", "0.817574");
        has("float3[] radiance:sphericalHarmonicsCoefficients", "(0, 1, 2)");
        has("color3f[] primvars:diffuseColor", "(0.6");
        has("float[] primvars:roughness", "0.75");
        has("normal3f[] primvars:normals", "(0, -1, -0)");
        assert!(text.contains("elementSize = 4\n") && text.contains("HarmonicsDegree = 1\n"));
        assert_eq!(values(&text, "float3[] velocities"), None, "the control");
    }

    #[test]
    fn package_stores_the_text_uncompressed_and_aligned() {
        let (bytes, text) = (encode_splats_package(&splats()).unwrap(), encode_splats(&splats()));
        let at = bytes.windows(9).position(|w| w == b"#usda 1.0").unwrap();
        assert_eq!(at % usize::from(ALIGNMENT), 0);
        assert_eq!(&bytes[at..at + text.len()], text.as_bytes());
        assert_eq!(bytes, encode_splats_package(&splats()).unwrap(), "the same bytes");
    }

    #[test]
    fn extent_contains_whole_gaussians_not_only_their_centres() {
        let splats = splats();
        let [least, most] = extent(&splats);
        for (i, p) in splats.positions.iter().enumerate() {
            let reach = Vec3::splat(REACH) * splats.scale(i).into_iter().fold(0.0, f32::max);
            assert!((*p - reach).cmpge(least).all() && (*p + reach).cmple(most).all());
        }
        assert!(least.x < -1.0, "a standard deviation of one half of a unit around the origin");
    }
}
