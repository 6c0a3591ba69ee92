//! A textured mesh with glTF's metallic-roughness material.

use glam::Vec3;
use serde_json::json;

use crate::formats::gltf::container::{Buffer, GltfTooLarge, asset};

/// `LINEAR`: no mipmaps, which would mix texels that are neighbours in the texture but not on the surface.
const LINEAR: u32 = 9729;

/// Textured triangles, +Z up. The lists of vertex attributes have the same length.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TexturedMesh {
    /// Vertices, capture units.
    pub positions: Vec<Vec3>,
    /// Unit normals of the vertices.
    pub normals: Vec<Vec3>,
    /// Texture coordinates of the vertices, 0 to 1 from the upper left corner.
    pub texture_coordinates: Vec<[f32; 2]>,
    /// Vertices of each triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// PNG of the base colour, sRGB.
    pub base_colour: Vec<u8>,
    /// PNG with roughness in green and metalness in blue, linear.
    pub metallic_roughness: Vec<u8>,
}

/// The bytes of a `.glb` file of `mesh`, rotated to +Y up.
///
/// # Errors
/// If the file would exceed 4 GiB.
pub fn encode_mesh(mesh: &TexturedMesh) -> Result<Vec<u8>, GltfTooLarge> {
    let mut file = Buffer::default();
    let y_up = |v: &Vec3| [v.x, v.z, -v.y];
    let attributes = json!({
        "POSITION": file.positions(mesh.positions.iter().map(y_up)),
        "NORMAL": file.rows(mesh.normals.iter().map(y_up)),
        "TEXCOORD_0": file.rows(mesh.texture_coordinates.iter().copied()),
    });
    let primitive = json!({
        "attributes": attributes, "indices": file.indices(mesh.triangles.as_flattened()), "material": 0,
    });
    let material = json!({
        "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicRoughnessTexture": { "index": 1 } },
        "doubleSided": true,
    });
    let images = [&mesh.base_colour, &mesh.metallic_roughness].map(|png| file.image(png));
    file.finish(json!({
        "asset": asset(),
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [primitive] }],
        "materials": [material],
        "samplers": [{ "magFilter": LINEAR, "minFilter": LINEAR, "wrapS": 33071, "wrapT": 33071 }],
        "textures": [{ "source": 0, "sampler": 0 }, { "source": 1, "sampler": 0 }],
        "images": images,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mesh_is_converted_to_y_up_and_has_both_textures() {
        let mesh = TexturedMesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(0.0, 2.0, 3.0)],
            normals: vec![Vec3::Z; 3],
            texture_coordinates: vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
            triangles: vec![[0, 1, 2]],
            base_colour: vec![1, 2, 3],
            metallic_roughness: vec![4; 5],
        };
        let bytes = encode_mesh(&mesh).unwrap();
        let text = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let document: serde_json::Value = serde_json::from_slice(&bytes[20..20 + text]).unwrap();
        assert_eq!(document["accessors"][0]["max"], json!([1.0, 3.0, 0.0]));
        assert_eq!(document["accessors"][0]["min"], json!([0.0, 0.0, -2.0]));
        let binary = &bytes[20 + text + 8..];
        let view = |name: &str, k: usize| {
            let view = &document["bufferViews"][document[name][k]["bufferView"].as_u64().unwrap() as usize];
            let at = view["byteOffset"].as_u64().unwrap() as usize;
            assert_eq!(at % 4, 0, "aligned");
            &binary[at..at + view["byteLength"].as_u64().unwrap() as usize]
        };
        assert_eq!((view("images", 0), view("images", 1)), (&[1, 2, 3][..], &[4; 5][..]));
        assert_eq!(document["images"][0]["mimeType"], "image/png");
        let indices = document["meshes"][0]["primitives"][0]["indices"].as_u64().unwrap() as usize;
        assert_eq!(view("accessors", indices), [0, 1, 2].map(u32::to_le_bytes).as_flattened());
    }
}
