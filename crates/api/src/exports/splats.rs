//! Exports of Gaussians in file formats of other programs.

use serde::{Deserialize, Serialize};

use crate::renders::EnvironmentSpec;
use relume_spec::rendering::{ExportedColour, MAX_BAKED_DEGREE, MaterialEdit};

/// Kind of an export of Gaussians: `gltf`, `usd`, `usdz` or `ply`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SplatsKind {
    /// glTF with KHR_gaussian_splatting, `.glb`.
    Gltf,
    /// OpenUSD as text, `.usda`.
    Usd,
    /// An OpenUSD package, `.usdz`.
    Usdz,
    /// PLY.
    Ply,
}

/// Gaussians in a file format of other programs, as from `relume export`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SplatsExport {
    /// File format: `gltf`, `usd`, `usdz` or `ply`.
    pub kind: SplatsKind,
    /// Quantity stored as colour: `radiance` (as in the photographs), `relit`, `albedo`, `normal`,
    /// `roughness` or `metallic`. Omitted: `relit` if `environment` is given, otherwise `radiance`; a PLY
    /// without `layer` and `environment` also contains the materials.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<String>, pattern = "^(radiance|relit|albedo|normal|roughness|metallic)$")]
    pub layer: Option<ExportedColour>,
    /// Light of the layer `relit`; not allowed with other layers. Omitted: the light of the capture.
    /// `inline_base64` is not accepted.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub environment: Option<EnvironmentSpec>,
    /// SH degree of the layer `relit`, 0 to 3. A higher degree stores more of the view dependence of
    /// highlights. Omitted: 3.
    #[serde(default = "most_degree")]
    #[schema(minimum = 0, maximum = 3)]
    pub relit_degree: u32,
    /// Rotates each Gaussian so that its shortest axis is its shading normal, for programs that use that axis
    /// as the normal. Omitted: false.
    #[serde(default)]
    pub flatten: bool,
    /// Greatest number of Gaussians, from 1: those that contribute most to views around the model. Omitted: all.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 1)]
    pub max_splats: Option<u32>,
    /// Greatest size of the file, bytes, with as many Gaussians as it allows. Omitted: not limited.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(minimum = 1)]
    pub max_bytes: Option<u64>,
    /// Changes of materials, as in a render request. Omitted: none.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    #[schema(max_items = 1000)]
    pub materials: Vec<MaterialEdit>,
}

impl SplatsExport {
    /// An export of `kind`. All other fields have their defaults.
    pub fn of(kind: SplatsKind) -> Self {
        Self {
            kind,
            layer: None,
            environment: None,
            relit_degree: most_degree(),
            flatten: false,
            max_splats: None,
            max_bytes: None,
            materials: Vec::new(),
        }
    }
}

fn most_degree() -> u32 {
    MAX_BAKED_DEGREE as u32
}
