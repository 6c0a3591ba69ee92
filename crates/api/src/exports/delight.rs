//! Exports of photographs without their light.

use serde::{Deserialize, Serialize};

use relume_spec::rendering::LayerFormat;

/// Kind of an export of photographs without their light.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DelightKind {
    /// Photographs without their light.
    #[default]
    Delight,
}

/// Albedo, shading, shadow and specular layers of the photographs of the model's capture, as from `relume delight`:
/// a zip with one `.exr` for each photograph, or with a folder of PNG files for each layer. The capture must exist.
///
/// An EXR has at most 32 bytes for each pixel, and a header.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct DelightExport {
    /// `delight`.
    pub kind: DelightKind,
    /// Names of the photographs, as in `GET /v1/captures/{id}/photographs`, 1 to 10,000. Omitted: all.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(min_items = 1, max_items = 10_000)]
    pub photographs: Option<Vec<String>>,
    /// Longest side of the layers, 16 to 8192 pixels. Omitted: the size of the photographs.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[serde(deserialize_with = "crate::lenient::optional_pixels")]
    #[schema(minimum = 16, maximum = 8192)]
    pub resolution: Option<u32>,
    /// Files: `exr` or `png`. Omitted: `exr`.
    #[serde(default)]
    #[schema(inline)]
    pub format: LayerFormat,
}
