//! The materials of a model.

use serde::{Deserialize, Serialize};

use relume_spec::rendering::Colour;

/// A material of a model: an albedo prototype with the surfaces that use it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct MaterialView {
    /// Number of the material, from 0, as in the field `materials` of a render request.
    pub material: u32,
    /// Mean albedo as a display colour, sRGB.
    #[schema(value_type = String, example = "#8a5a33")]
    pub colour: Colour,
    /// Mean albedo, linear Rec.709, 0 to 1.
    pub albedo: [f32; 3],
    /// Share of the surface of the model, 0 to 1.
    pub share: f32,
    /// Mean roughness, 0 to 1.
    pub roughness: f32,
    /// Mean metalness, 0 to 1.
    pub metalness: f32,
}
