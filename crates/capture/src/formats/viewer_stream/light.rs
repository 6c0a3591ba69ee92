//! A light in the form with which a viewer shades the Gaussians of one model.

use serde_json::{Map, Value, json};

use crate::formats::viewer_stream::encode;
use crate::formats::viewer_stream::quantity::Quantity;
use relume_scene::{EnvMap, MAX_LIGHTS, SplitLight};

const MAGIC: [u8; 4] = *b"RLML";

/// A light prepared for one model.
pub struct StreamedLight<'a> {
    /// Tables of the reflectance model: pairs `[roughness][n.v]` of scale and bias, then attenuations `[roughness][degree]`.
    pub reflectance: Vec<f32>,
    /// Diffuse transfer `[node][rgb][coefficient]`, prefiltered radiance `[node][rgb]` level by level, then the RGB
    /// irradiance of [`MAX_LIGHTS`] lights, zero beyond the last.
    pub tables: Vec<f32>,
    /// Nodes along an edge of the cube grid of normals.
    pub diffuse_nodes: usize,
    /// Coefficients per colour in the diffuse transfer, including padding.
    pub coefficients: usize,
    /// Nodes along an edge of the grid of each level.
    pub specular_nodes: Vec<usize>,
    /// Lights that are not part of the tables.
    pub lights: &'a [SplitLight],
    /// Light at each Gaussian that is not part of the tables, in the order of the stream.
    pub surfaces: Vec<StreamedSurface>,
    /// The background of the model, if requested.
    pub map: Option<EnvMap>,
}

/// Light that arrives at a Gaussian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StreamedSurface {
    /// Irradiance from other surfaces, RGB, W/m^2.
    pub gathered: [f32; 3],
    /// Mean radiance from the directions in which the environment is blocked, RGB, W/(m^2 sr).
    pub blocked: [f32; 3],
    /// Share of each separate light that arrives, 0 to 1.
    pub arriving: [f32; MAX_LIGHTS],
}

/// The stream of a light.
pub fn encode_light(light: &StreamedLight<'_>) -> Vec<u8> {
    let column = |pick: &dyn Fn(&StreamedSurface) -> [f32; 3]| light.surfaces.iter().flat_map(pick).collect();
    let arriving = light.surfaces.iter().flat_map(|s| s.arriving).collect();
    let records = [
        Quantity::half("gathered", 3, column(&|s| s.gathered)),
        Quantity::half("blocked", 3, column(&|s| s.blocked)),
        Quantity::coarse("arriving", MAX_LIGHTS, arriving),
    ];
    let mut arrays = vec![
        Quantity::full("reflectance", 1, light.reflectance.clone()),
        Quantity::half("tables", 1, light.tables.clone()),
    ];
    let mut facts = Map::from_iter([
        ("diffuse_nodes".to_owned(), json!(light.diffuse_nodes)),
        ("coefficients".to_owned(), json!(light.coefficients)),
        ("specular_nodes".to_owned(), json!(light.specular_nodes)),
        ("lights".to_owned(), light.lights.iter().map(to_json).collect()),
    ]);
    if let Some(map) = &light.map {
        facts.insert("map".to_owned(), json!({ "width": map.width(), "height": map.height() }));
        arrays.push(Quantity::half("map", 3, map.texels().iter().flatten().copied().collect()));
    }
    encode(MAGIC, facts, &arrays, &records)
}

fn to_json(light: &SplitLight) -> Value {
    json!({ "direction": light.direction, "radius": light.radius })
}
