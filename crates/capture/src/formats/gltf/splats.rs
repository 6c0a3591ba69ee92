//! Splats as binary glTF with the extension `KHR_gaussian_splatting`. Materials are stored as custom attributes
//! (`_BASE_COLOR`, `_ROUGHNESS`, `_METALLIC`, `_NORMAL`), which other readers ignore.

use serde_json::{Map, Value, json};

use crate::formats::gltf::container::{Buffer, GltfTooLarge, asset};
use crate::formats::splats::Splats;

const EXTENSION: &str = "KHR_gaussian_splatting";

/// The bytes of a `.glb` file of `splats`, which have +Y up. A reader without the extension shows points in their
/// mean colours.
///
/// # Errors
/// If the file would exceed 4 GiB.
pub fn encode_splats(splats: &Splats) -> Result<Vec<u8>, GltfTooLarge> {
    let mut file = Buffer::default();
    let every = 0..splats.len();
    let positions = splats.positions.iter().map(|p| p.to_array());
    let mut attributes = Map::new();
    attributes.insert("POSITION".to_owned(), file.positions(positions));
    let mut add = |name: String, accessor: Value| attributes.insert(name, accessor);
    let own = |name: &str| format!("{EXTENSION}:{name}");
    let fallback = every.clone().map(|i| {
        let [r, g, b] = splats.mean_colour(i);
        [r, g, b, splats.opacity(i)]
    });
    add("COLOR_0".to_owned(), file.rows(fallback));
    add(own("ROTATION"), file.rows(splats.rotations.iter().map(|q| q.as_quat().normalize().to_array())));
    add(own("SCALE"), file.rows(every.clone().map(|i| splats.scale(i))));
    add(own("OPACITY"), file.rows(every.clone().map(|i| [splats.opacity(i)])));
    for l in 0..=splats.degree {
        for n in 0..=2 * l {
            let coefficients = every.clone().map(|i| splats.harmonics(i)[l * l + n]);
            add(own(&format!("SH_DEGREE_{l}_COEF_{n}")), file.rows(coefficients));
        }
    }
    let materials = &splats.materials;
    add("_BASE_COLOR".to_owned(), file.rows(materials.iter().map(|m| m.albedo)));
    add("_ROUGHNESS".to_owned(), file.rows(materials.iter().map(|m| [m.roughness])));
    add("_METALLIC".to_owned(), file.rows(materials.iter().map(|m| [m.metallic])));
    add("_NORMAL".to_owned(), file.rows(splats.normals.iter().map(|n| n.to_array())));
    let kind = json!({
        "kernel": "ellipse", "colorSpace": "srgb_rec709_display",
        "projection": "perspective", "sortingMethod": "cameraDistance",
    });
    let primitive = json!({ "mode": 0, "attributes": attributes, "extensions": { EXTENSION: kind } });
    file.finish(json!({
        "asset": asset(),
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [primitive] }],
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::splats::tests::example;

    /// The document of a file and the floats of an attribute.
    fn read(bytes: &[u8], attribute: &str) -> (Value, Option<Vec<f32>>) {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
        let text = word(12);
        assert_eq!((&bytes[16..20], text % 4), (&b"JSON"[..], 0));
        let document: Value = serde_json::from_slice(&bytes[20..20 + text]).unwrap();
        let start = 20 + text + 8;
        assert_eq!((&bytes[start - 4..start], word(start - 8)), (&b"BIN\0"[..], bytes.len() - start));
        let index = &document["meshes"][0]["primitives"][0]["attributes"][attribute];
        let Some(index) = index.as_u64() else { return (document, None) };
        let accessor = &document["accessors"][index as usize];
        let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let at = start + view["byteOffset"].as_u64().unwrap() as usize;
        let end = at + view["byteLength"].as_u64().unwrap() as usize;
        let floats = bytes[at..end].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        (document.clone(), Some(floats))
    }

    #[test]
    fn file_contains_the_values_of_the_model() {
        let splats = Splats::of(&example()).with_y_up();
        let bytes = encode_splats(&splats).unwrap();
        let floats = |name: &str| read(&bytes, name).1.unwrap_or_else(|| panic!("{name} is missing"));
        assert_eq!(floats("POSITION")[3..], [0.5, 0.125, 1.25], "capture units, +Y up");
        let scale = &floats("KHR_gaussian_splatting:SCALE")[3..];
        assert!((scale[0] - 0.5 * (-1f32).exp()).abs() < 1e-6, "linear: {scale:?}");
        assert!((floats("KHR_gaussian_splatting:OPACITY")[1] - 0.817_574_5).abs() < 1e-6);
        assert_eq!(floats("KHR_gaussian_splatting:SH_DEGREE_0_COEF_0")[3..], [0.0, 1.0, 2.0]);
        // The rotation moves the coefficient of z to y, and that of -y to z.
        let first = floats("KHR_gaussian_splatting:SH_DEGREE_1_COEF_0");
        assert!((first[3] + 6.0).abs() < 1e-5, "{first:?}");
        assert_eq!(floats("KHR_gaussian_splatting:ROTATION").len(), 8);
        assert_eq!(floats("COLOR_0").len(), 8);
        assert!((floats("_ROUGHNESS")[1] - 0.75).abs() < 1e-6 && floats("_METALLIC")[1] == 0.5);
        assert_eq!(floats("_NORMAL")[3..], [0.0, -1.0, 0.0]);
        assert!((floats("_BASE_COLOR")[3] - 0.6).abs() < 1e-6);
    }

    #[test]
    fn file_contains_only_the_sh_degrees_of_the_model() {
        let bytes = encode_splats(&Splats::of(&example())).unwrap();
        let (document, none) = read(&bytes, "KHR_gaussian_splatting:SH_DEGREE_2_COEF_0");
        assert_eq!(none, None);
        assert!(read(&bytes, "KHR_gaussian_splatting:SH_DEGREE_1_COEF_2").1.is_some(), "the control");
        let kind = &document["meshes"][0]["primitives"][0]["extensions"][EXTENSION];
        assert_eq!(
            (&kind["kernel"], &kind["colorSpace"]),
            (&json!("ellipse"), &json!("srgb_rec709_display"))
        );
        assert_eq!(document["accessors"][0]["max"], json!([0.5, -1.0, 0.125]));
        assert_eq!(document["accessors"][0]["min"], json!([0.0, -1.25, 0.0]));
    }
}
